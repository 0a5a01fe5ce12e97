# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bench: all rows move the same arm, and the table says what was measured. Nothing is timed."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from benchmarks import __main__ as bench
from benchmarks import against, c_reference, casadi_peer, mujoco_peer, own, pinocchio_peer, roboticstoolbox_peer, table
from benchmarks.measure import first_calls, measured, order_of_calls
from benchmarks.task import STEP, Row, Task, Unavailable
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator

needs_compiler = pytest.mark.skipif(c_reference.compiler() is None, reason="no C compiler")

VISCOUS = tuple(
    parse_effect(f"viscous_friction:joint={joint},coefficient={value}")
    for joint, value in ((1, 0.3), (2, 0.5), (3, 0.2))
)
START = np.array([0.1, -0.4, 0.7, 0.3, -0.2, 0.5, 0.5, -1.0, 0.8])


def held(plant, seconds=0.5, volts=(20.0, -15.0, 10.0)):
    return Task(plant, START, np.tile(np.array(volts), (round(seconds / STEP), 1)))


def ours(task):
    simulator = Simulator(task.plant, max_step=STEP)
    simulator.reset(task.state[:3], task.state[3:6], task.state[6:])
    voltages = np.vstack([task.voltages, task.voltages[-1:]])
    run = simulator.run(STEP * np.arange(task.steps + 1), voltages)
    return np.hstack([run.position, run.velocity, run.current])


def row(label="row", seconds=10.0, times=(1.0,), position=(0.0, 0.0, 0.0), **more):
    """A row that takes the given times, one after the other."""
    clock = iter(np.resize(times, 1000))
    return Row(
        label, lambda: np.array(position), seconds, measure=lambda: (float(next(clock)), np.array(position)), **more
    )


# the C reference


@needs_compiler
@pytest.mark.parametrize("effects", [(), VISCOUS], ids=["frictionless", "viscous"])
@pytest.mark.parametrize("name", ["bejczy", "paul", "corke_armstrong_1994"])
def test_c_reference_agrees_with_the_kernel(name, effects):
    task = held(Plant.of(name, effects))
    np.testing.assert_allclose(c_reference.CReference().prepared(task)(), ours(task), rtol=0.0, atol=1e-9)


@needs_compiler
def test_c_reference_gives_the_regression_value():
    end = c_reference.CReference().prepared(held(Plant.of("bejczy", VISCOUS)))()[-1]
    np.testing.assert_allclose(end[:3], (0.68745378, -0.6102092, 1.07667885), rtol=0.0, atol=1e-7)


@needs_compiler
def test_c_reference_reports_what_the_compiler_says():
    with pytest.raises(Unavailable, match="-O3 -fno-such-flag failed"):
        c_reference.CReference(("-O3", "-fno-such-flag"))


def test_without_a_compiler_the_c_rows_are_listed_as_missing(monkeypatch):
    monkeypatch.setattr(c_reference, "compiler", lambda: None)
    found = bench.Bench(Task.default(0.01))
    found.add("C", c_reference.rows)
    assert found.rows == [] and found.missing == {"C": "no C compiler"}


# the peers


@pytest.mark.parametrize(
    "peer", [mujoco_peer, pinocchio_peer, roboticstoolbox_peer, casadi_peer], ids=lambda peer: peer.PACKAGES[0]
)
def test_peers_move_the_same_arm(peer):
    if not all(map(bench.installed, peer.PACKAGES)):
        pytest.skip(f"{peer.PACKAGES[0]} is not installed")
    task = Task.default(0.2)
    expected = ours(task)
    for peer_row in peer.rows(task):
        end = expected[round(peer_row.motion / STEP), :3]
        np.testing.assert_allclose(peer_row.run(), end, rtol=0.0, atol=peer_row.tolerance, err_msg=peer_row.label)


@pytest.mark.long
def test_own_rows_move_the_same_arm():
    task = Task.default(0.2)
    with own.helper(task) as child:
        for own_row in own.rows(task, child):
            if own_row.compared and own_row.motion == task.seconds:
                np.testing.assert_allclose(
                    own_row.measure()[1], ours(task)[-1, :3], rtol=0.0, atol=own_row.tolerance, err_msg=own_row.label
                )


def test_task_moves_all_joints_far_enough_to_tell_arms_apart():
    assert (np.ptp(ours(Task.default())[:, :3], axis=0) > 0.8).all()


def test_missing_peers_are_listed_and_left_out():
    found = bench.Bench(Task.default(0.01))
    found.add("nobody", lambda task: [row()], packages=("puma-sim-no-such-package",))
    assert found.rows == []
    assert found.missing == {"nobody": "not installed (pip install puma-sim-no-such-package)"}


def test_a_broken_peer_does_not_take_the_others_with_it():
    def broken(task):
        raise RuntimeError("no such symbol\nand more")

    found = bench.Bench(Task.default(0.01))
    found.add("broken", broken, packages=("numpy",))
    found.add("sound", lambda task: [row("sound")], packages=("numpy",))
    assert [r.label for r in found.rows] == ["sound"]
    assert found.missing == {"broken": "failed with RuntimeError: no such symbol"}


def test_our_own_failure_is_not_hidden():
    def broken(task):
        raise RuntimeError("ours")

    with pytest.raises(RuntimeError, match="ours"):
        bench.Bench(Task.default(0.01)).add("puma_sim", broken)


# measuring


def test_a_round_calls_each_row_its_number_of_times_spread_over_the_round():
    rows = [row("often", calls=4), row("once"), row("as often", calls=4)]
    order = order_of_calls(rows, 0)
    assert [order.count(k) for k in range(3)] == [4, 1, 4]
    # the two that are compared most closely take turns
    assert [k for k in order if k != 1] == [0, 2] * 4
    assert [k for k in order_of_calls(rows, 2) if k != 1] != [0, 2] * 4


def test_a_rounds_figure_is_the_median_of_its_calls():
    rows = [row("spiky", times=(1.0, 50.0, 2.0), calls=3), row("steady", times=(7.0,))]
    np.testing.assert_array_equal(measured(rows, 4), [[2.0, 7.0]] * 4)


def test_first_calls_give_the_final_positions():
    np.testing.assert_array_equal(first_calls([row(position=(1.0, 2.0, 3.0))]), [[1.0, 2.0, 3.0]])


# the table


def test_ratios_are_taken_within_each_round():
    # the machine is ten times slower in the second of three rounds, and both rows feel it
    times = np.array([[1.0, 3.0], [10.0, 30.0], [2.0, 6.0]])
    first, second = table.results([row("a"), row("b")], times, [None, 0.0], 10.0)
    assert (first.ratio.median, first.ratio.low, first.ratio.high) == (1.0, 1.0, 1.0)
    assert (second.ratio.median, second.ratio.low, second.ratio.high) == (3.0, 3.0, 3.0)
    assert second.time.median == 6.0


def test_shorter_and_longer_calls_are_scaled_to_the_same_simulated_time():
    rows = [row("run", seconds=10.0), row("short", seconds=0.5), row("batch", seconds=640.0)]
    found = table.results(rows, np.array([[1.0, 1.0, 16.0]]), [None] * 3, 10.0)
    assert [result.ratio.median for result in found] == [1.0, 20.0, 0.25]


def results_with(**more):
    rows = [row("ours"), row("theirs", note="in steps of 2 ms", **more), row("theirs too", note="in steps of 2 ms")]
    return table.results(rows, np.array([[0.002, 0.1, 1.0]]), [None, 2e-5, 1e-12], 10.0)


def test_table_lists_each_row_with_its_time_ratio_and_notes():
    text = table.table_text(results_with(tolerance=1e-4), 10.0)
    lines = text.splitlines()
    assert re.match(r"theirs +100 .* 50\.0 .* 2e-05 +1$", lines[3])
    assert re.match(r"theirs too +1000 .* 500 .* 1e-12 +1$", lines[4])
    assert lines[5:] == ["  1  in steps of 2 ms"]
    assert "NOT THE SAME ARM" not in text


def test_another_arm_is_named():
    found = results_with(tolerance=1e-6)
    assert "NOT THE SAME ARM: it may end at most 1e-06 rad" in table.table_text(found, 10.0)
    assert table.same_arm_text(found) == "NOT THE SAME ARM: theirs"


def test_the_same_arm_is_stated_with_the_worst_difference():
    text = table.same_arm_text(results_with(tolerance=1e-4))
    assert text.startswith("same arm: worst difference 2.0e-05 rad at the end (theirs)")


@pytest.mark.parametrize(
    "value, text", [(0.0, "0"), (0.01234, "0.0123"), (1.0, "1.00"), (2.346, "2.35"), (98.7, "98.7"), (1234.5, "1234")]
)
def test_numbers_have_three_digits_and_no_exponent(value, text):
    assert table.number(value) == text


def test_targets_say_reached_not_reached_or_not_measured():
    spread = table.Spread.of([1.2, 1.1, 1.4])
    targets = [
        table.Target("low enough", spread, True, 1.3),
        table.Target("high enough", spread, False, 1.3),
        table.Target("absent", None, True, 1.3),
    ]
    assert [target.reached for target in targets] == [True, False, None]
    lines = table.targets_text(targets).splitlines()[2:]
    assert [line.split("  ")[-1].strip() for line in lines] == ["reached", "not reached", "not measured"]


# the command


@pytest.mark.thorough
def test_the_command_prints_one_table_and_writes_the_numbers(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "QUICK_SECONDS", 0.02)
    monkeypatch.setattr(own, "BATCH_RUNS", 8)
    monkeypatch.setattr(own, "FITTING_RUNS", 8)
    monkeypatch.setattr(bench, "installed", lambda package: package == "numpy")
    monkeypatch.setattr(own, "import_seconds", lambda module: [0.1, 0.2, 0.3])
    path = tmp_path / "bench.json"
    assert bench.main(["--quick", "--rounds", "1", "--peers", "mujoco,casadi", "--json", str(path)]) == 0
    output = capsys.readouterr()
    assert output.err == ""  # progress is for a terminal
    assert output.out.count("note") == 1
    assert "mujoco: not installed (pip install mujoco)" in output.out
    assert "casadi: not installed (pip install casadi)" in output.out
    assert "NOT THE SAME ARM" not in output.out
    numbers = json.loads(path.read_text())
    assert set(numbers["not_measured"]) >= {"mujoco", "casadi"}
    assert all(result["same_arm"] for result in numbers["rows"])
    for result in numbers["rows"]:
        assert result["label"] in output.out
    reached = {target["what"]: target["reached"] for target in numbers["targets"]}
    assert reached["MuJoCo rollout / one compiled call"] is None
    assert reached["import puma_sim_core without numba"] is True


@pytest.mark.parametrize(
    "arguments, complaint",
    [
        (["--peers", "gazebo"], "unknown peer 'gazebo'; expected some of mujoco, pinocchio"),
        (["--rounds", "0"], "--rounds: 0; expected 1 or more"),
        (["--json", "no/such/folder/bench.json"], "no folder no/such/folder; expected one that is"),
    ],
)
def test_a_wrong_command_line_is_refused(arguments, complaint, capsys):
    with pytest.raises(SystemExit) as refused:
        bench.main(arguments)
    assert refused.value.code == 2
    assert complaint in capsys.readouterr().err


def test_two_checkouts_are_timed_in_one_run(tmp_path):
    """Each case of `make bench AGAINST=...` runs on both sides, here of one and the same checkout."""
    seconds, megabytes = against.measured("Coulomb friction", "python", (against.ROOT, against.ROOT), 2)
    assert seconds.shape == (2, 2, 2) and (seconds > 0.0).all()
    assert megabytes.shape == (2,) and (megabytes > 10.0).all()
    with pytest.raises(SystemExit, match="no such effect"):
        against.measured("no such effect", "python", (against.ROOT, against.ROOT), 1)
