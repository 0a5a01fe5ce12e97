# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim simulate`: the rows that come out are the motion of the arm under the rows that go in.

The independent integration is DOP853 on the matrix form of the equations, row by row, since the
voltages jump between rows by up to 24 V. On these runs RK4 in steps of 28/30 ms stays within
6e-8 rad, 1e-5 rad/s and 2.5e-4 A of it; with 0.1 ms each falls by the fourth power, 7600-fold.
"""

from __future__ import annotations

import fcntl
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from arm_reference import START, VISCOUS, plant_of, right_hand_side
from cli_support import HEADER, ROOT, call, contents, puma_sim, random_volts, read_run, states, triple, write_volts
from scipy.integrate import solve_ivp

from puma_sim_core import jit
from puma_sim_core.plant.model_file import dump_model
from puma_sim_core.recording.recording import read_csv
from puma_sim_core.simulation.run_inputs import GREATEST_STEP

pytestmark = pytest.mark.long
INITIAL = ("--initial", triple(START[0]), "--initial-velocity", triple(START[1]), "--initial-current", triple(START[2]))
EFFECTS = tuple(word for text in VISCOUS for word in ("--effect", text))


def integrated(plant, time, voltage, start, given=(None, None, None)):
    """(n, 9) states at the times."""
    rows = [np.concatenate(start)]
    for r in range(len(time) - 1):
        run = solve_ivp(
            right_hand_side(plant, voltage[r], given),
            (time[r], time[r + 1]),
            rows[-1],
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
        )
        rows.append(run.y[:, -1])
    return np.array(rows)


@pytest.fixture
def volts(tmp_path):
    return random_volts(tmp_path / "volts.csv")


def simulate(volts, out, *options):
    assert call("simulate", volts, "--out", out, "--force", *options) == 0
    return read_run(out)


# ------------------------------------------------------------------------------ what comes out


def test_columns_and_times_are_those_that_the_issue_names(volts, tmp_path):
    run = simulate(volts, tmp_path / "run.csv")
    given = read_csv(volts)
    groups = [f"{group}{j}" for group in ("voltage", "position", "velocity", "current") for j in (1, 2, 3)]
    first = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert first == ",".join(["time", *groups])
    assert np.array_equal(run.time, given.time) and np.array_equal(run.voltage, given.voltage)


def test_the_arm_starts_at_rest_without_current(volts, tmp_path):
    assert not states(simulate(volts, tmp_path / "run.csv"))[0].any()


@pytest.mark.parametrize("form", ["physical", "printed"])
@pytest.mark.parametrize("step, atol", [(None, (1e-7, 2e-5, 4e-4)), (1e-4, (2e-11, 4e-9, 1e-7))])
def test_each_row_is_the_state_at_its_time(volts, tmp_path, form, step, atol):
    given = read_csv(volts)
    expected = integrated(plant_of(*VISCOUS, torque_form=form), given.time, given.voltage, START)
    run = simulate(
        volts, tmp_path / "run.csv", *INITIAL, *EFFECTS, "--torque-form", form, *(("--max-step", step) if step else ())
    )
    for name, columns, tolerance in zip(
        ("position", "velocity", "current"), (slice(0, 3), slice(3, 6), slice(6, 9)), atol
    ):
        np.testing.assert_allclose(getattr(run, name), expected[:, columns], rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.parametrize(
    "form, end", [("physical", (0.68745378, -0.6102092, 1.07667885)), ("printed", (0.30113443, 0.48721605, 0.90871915))]
)
def test_one_long_row_gives_the_regression_value(tmp_path, form, end):
    """The row of 0.5 s is one line of the file and many steps of at most 28/30 ms."""
    volts = write_volts(tmp_path / "volts.csv", [0.0, 0.5], [(20.0, -15.0, 10.0), (0.0, 0.0, 0.0)])
    run = simulate(volts, tmp_path / "run.csv", *INITIAL, *EFFECTS, "--torque-form", form)
    np.testing.assert_allclose(run.position[-1], end, rtol=0, atol=1e-7)


def test_a_row_acts_until_the_next_and_not_before(volts, tmp_path):
    """Other voltages from row k on leave rows 0 to k as they are, to the last bit."""
    given = read_csv(volts)
    other = given.voltage.copy()
    other[70:] += 1.0
    changed = write_volts(tmp_path / "other.csv", given.time, other)
    first = states(simulate(volts, tmp_path / "first.csv"))
    second = states(simulate(changed, tmp_path / "second.csv"))
    assert np.array_equal(first[:71], second[:71])
    assert (first[71:] != second[71:]).all(axis=0).any()


def test_a_run_in_two_parts_is_the_run_in_one(volts, tmp_path):
    options = (*EFFECTS, "--effect", "coulomb_friction:joint=2,torque=12")
    given = read_csv(volts)
    whole = simulate(volts, tmp_path / "whole.csv", *INITIAL, *options)
    for k in (1, 60, len(given) - 2):
        head = write_volts(tmp_path / "head.csv", given.time[: k + 1], given.voltage[: k + 1])
        tail = write_volts(tmp_path / "tail.csv", given.time[k:], given.voltage[k:])
        first = simulate(head, tmp_path / "first.csv", *INITIAL, *options)
        second = simulate(
            tail,
            tmp_path / "second.csv",
            *options,
            "--initial",
            triple(first.position[-1]),
            "--initial-velocity",
            triple(first.velocity[-1]),
            "--initial-current",
            triple(first.current[-1]),
        )
        assert np.array_equal(states(first), states(whole)[: k + 1])
        assert np.array_equal(states(second), states(whole)[k:])


def test_long_runs_go_part_by_part_to_the_same_bits(volts, tmp_path, monkeypatch):
    from puma_sim_core.cli import simulate as module

    options = (*EFFECTS, "--effect", "presliding_friction:joint=1,torque=8", "--max-acceleration", "1e3,1e3,1e3")
    simulate(volts, tmp_path / "whole.csv", *options)
    for budget in (1, 7, 100):
        monkeypatch.setattr(module, "_STEPS_AT_ONCE", {"numba": budget, "python": budget})
        simulate(volts, tmp_path / "parts.csv", *options)
        assert (tmp_path / "parts.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_a_file_of_one_row_gives_the_start(tmp_path):
    volts = write_volts(tmp_path / "volts.csv", [3.0], [(1.0, 2.0, 3.0)])
    run = simulate(volts, tmp_path / "run.csv", *INITIAL)
    assert run.time.tolist() == [3.0] and np.array_equal(states(run)[0], np.concatenate(START))


# ------------------------------------------------------------------------ the command as a whole


def test_reruns_are_byte_equal_in_other_processes_and_with_both_kernels(volts, tmp_path):
    written = set()
    for n, kernel in enumerate(("auto", "auto", "python")):
        out = tmp_path / f"run{n}.csv"
        done = puma_sim(
            "simulate",
            volts,
            "--out",
            out,
            *INITIAL,
            *EFFECTS,
            "--effect",
            "stribeck_friction:joint=3,torque=4",
            PUMA_SIM_KERNEL=kernel,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout == ""
        written.add(out.read_bytes())
    assert len(written) == 1
    assert "python kernel" in done.stderr


@pytest.mark.skipif(jit.BACKEND != "numba", reason="there is nothing to compile")
def test_from_a_cold_cache_a_run_compiles_nothing_by_itself(volts, tmp_path, monkeypatch):
    """While another process, which this test plays, has the lock of the cache."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "cache").mkdir()
    folder = Path(jit.cache_directory())
    with open(folder / "compiled-lock", "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for number, words in enumerate([(), ("--restart", 0.1)]):
            source = tmp_path / "0.csv" if words else volts
            out = tmp_path / f"{number}.csv"
            done = puma_sim("simulate", source, *words, "--out", out, "--limits", "off", PUMA_SIM_KERNEL="auto")
            assert "simulated by the python kernel" in done.stderr, done.stderr
    assert not list(folder.rglob("*.nbi"))


def test_the_summary_says_rows_seconds_and_kernel(volts, tmp_path, capsys):
    from puma_sim_core.jit import BACKEND

    run = simulate(volts, tmp_path / "run.csv")
    out, err = capsys.readouterr()
    span = f"{run.time[-1] - run.time[0]:.6g} s simulated"
    assert out == "" and "150 rows" in err and span in err and f"{BACKEND} kernel" in err


def test_standard_output_holds_the_file_and_nothing_else(volts, tmp_path, capsys):
    simulate(volts, tmp_path / "run.csv")
    capsys.readouterr()
    assert call("simulate", volts, "--out", "-") == 0
    assert capsys.readouterr().out == (tmp_path / "run.csv").read_text()
    done = puma_sim("simulate", volts, "--out", "-")
    assert done.returncode == 0 and done.stdout == (tmp_path / "run.csv").read_text()


def test_voltages_may_come_through_a_pipe(volts, tmp_path):
    simulate(volts, tmp_path / "run.csv")
    done = subprocess.run(
        [sys.executable, "-m", "puma_sim_core", "simulate", "/dev/stdin", "--out", "/dev/stdout"],
        input=volts.read_bytes(),
        cwd=ROOT,
        capture_output=True,
        timeout=170,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == (tmp_path / "run.csv").read_bytes()


def test_columns_may_stand_in_any_order_below_comments(tmp_path):
    plain = tmp_path / "plain.csv"
    plain.write_text(f"{HEADER}\n0,1,2,3\n0.5,-4,-5,-6\n1,0,0,0\n")
    other = tmp_path / "other.csv"
    other.write_bytes(
        b"\xef\xbb\xbf# bench 3\r\n\r\n voltage3, time ,voltage1,voltage2\r\n"
        b'3,0,1, 2\r\n# changed\r\n-6,0.5,-4,-5\r\n"0",1e0,0,0\r\n'
    )
    simulate(plain, tmp_path / "a.csv")
    simulate(other, tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_an_output_link_leads_to_its_file(volts, tmp_path):
    real, link = tmp_path / "real.csv", tmp_path / "link.csv"
    link.symlink_to(real)
    simulate(volts, link)
    assert link.is_symlink() and len(read_run(real)) == 150


# ------------------------------------------------------------------------------------- the plant


def test_a_model_file_stands_for_parameters_and_effects(volts, tmp_path):
    texts = ("coulomb_friction:joint=2,torque=12", "payload:mass=1.7")
    effects = [word for text in texts for word in ("--effect", text)]
    dump_model(plant_of(*texts, name="paul", torque_form="printed"), tmp_path / "model.yaml")
    simulate(volts, tmp_path / "a.csv", "--parameters", "paul", *effects, "--torque-form", "printed")
    simulate(volts, tmp_path / "b.csv", "--model", tmp_path / "model.yaml")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert (
        call("model", "--parameters", "paul", *effects, "--torque-form", "printed", "--out", tmp_path / "written.yaml")
        == 0
    )
    assert (tmp_path / "written.yaml").read_bytes() == (tmp_path / "model.yaml").read_bytes()


def test_effects_add_to_those_of_the_model(volts, tmp_path):
    one, two = "coulomb_friction:joint=2,torque=12", "viscous_friction:joint=2,coefficient=9.5"
    dump_model(plant_of(one), tmp_path / "model.yaml")
    both = simulate(volts, tmp_path / "a.csv", "--effect", one, "--effect", two)
    added = simulate(volts, tmp_path / "b.csv", "--model", tmp_path / "model.yaml", "--effect", two)
    alone = simulate(volts, tmp_path / "c.csv", "--model", tmp_path / "model.yaml")
    assert np.array_equal(states(added), states(both))
    assert not np.array_equal(states(added), states(alone))


def test_the_default_set_is_bejczy_and_others_differ(volts, tmp_path):
    default = states(simulate(volts, tmp_path / "a.csv"))
    assert np.array_equal(states(simulate(volts, tmp_path / "b.csv", "--parameters", "bejczy")), default)
    assert not np.array_equal(states(simulate(volts, tmp_path / "c.csv", "--parameters", "paul")), default)


def test_an_arm_that_sticks_stays_where_it_is(tmp_path):
    volts = write_volts(
        tmp_path / "volts.csv", [0.0, 60.0, 600.0], [(0.5, 0.0, 0.4), (-0.5, 0.0, -0.4), (0.0, 0.0, 0.0)]
    )
    run = simulate(
        volts,
        tmp_path / "run.csv",
        "--max-step",
        GREATEST_STEP,
        "--initial",
        "0.3,-1.4,0.2",
        *(word for j in (1, 2, 3) for word in ("--effect", f"coulomb_friction:joint={j},torque=90")),
    )
    assert np.array_equal(run.position, np.tile((0.3, -1.4, 0.2), (3, 1)))
    assert not run.velocity.any()


# ------------------------------------------------------------------------------------ constraints


@pytest.mark.parametrize(
    "texts, given, own",
    [
        (["joint1=hold"], (0.0, None, None), {0: 0.0}),
        (["joint2=velocity:0.5", "joint3=free"], (None, 0.0, None), {1: 0.5}),
        (["joint1=velocity", "joint3=hold"], (0.0, None, 0.0), {0: START[1][0], 2: 0.0}),
        (["joint3=acceleration:-1.5"], (None, None, -1.5), {2: START[1][2]}),
        (
            ["joint1=hold", "joint2=velocity:-0.2", "joint3=acceleration:1"],
            (0.0, 0.0, 1.0),
            {0: 0.0, 1: -0.2, 2: START[1][2]},
        ),
    ],
)
def test_constrained_joints_move_as_told_and_the_others_obey_the_reduced_equations(volts, tmp_path, texts, given, own):
    velocity = [0.0 if j in own and own[j] != START[1][j] else w for j, w in enumerate(START[1])]
    begin = [own.get(j, w) for j, w in enumerate(START[1])]
    run = simulate(
        volts,
        tmp_path / "run.csv",
        *EFFECTS,
        "--max-step",
        1e-4,
        "--initial",
        triple(START[0]),
        "--initial-velocity",
        triple(velocity),
        "--initial-current",
        triple(START[2]),
        *(word for text in texts for word in ("--constrain", text)),
    )
    t = run.time - run.time[0]
    for j, w in own.items():
        np.testing.assert_allclose(run.position[:, j], START[0][j] + w * t + 0.5 * given[j] * t * t, atol=1e-12)
    expected = integrated(plant_of(*VISCOUS), run.time, run.voltage, (START[0], begin, START[2]), given)
    np.testing.assert_allclose(states(run)[:, :6], expected[:, :6], rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.current, expected[:, 6:], rtol=0, atol=1e-6)


# ----------------------------------------------------------------------------------------- limits


@pytest.fixture
def far(tmp_path):
    """40 V for 2 s drive joints 1 and 3 out of their ranges, and joint 2 not."""
    return write_volts(
        tmp_path / "far.csv", [0.0, 1.0, 2.0, 2.01, 3.0], [(40.0, 0.0, 40.0)] * 2 + [(0.0, 0.0, 0.0)] * 3
    )


def warnings(capsys):
    return [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning")]


def test_joints_that_leave_their_range_are_reported_once_each(far, tmp_path, capsys):
    run = simulate(far, tmp_path / "run.csv")
    lines = warnings(capsys)
    assert len(lines) == 2
    for j, line in zip((0, 2), lines):
        low, high = plant_of().arm.joint_ranges[j]
        r = np.flatnonzero((run.position[:, j] > high) | (run.position[:, j] < low))[0]
        joint, position, at = re.search(r"joint (\d): position (\S+) rad at (\S+) s", line).groups()
        assert int(joint) == j + 1
        assert float(position) == pytest.approx(run.position[r, j], rel=1e-3)
        assert float(at) == pytest.approx(run.time[r], rel=1e-5)


def test_limits_can_be_off(far, tmp_path, capsys):
    simulate(far, tmp_path / "run.csv", "--limits", "off")
    assert not warnings(capsys)


def test_limits_can_be_errors_and_nothing_is_written(far, tmp_path, capsys):
    before = contents(tmp_path)
    assert call("simulate", far, "--out", tmp_path / "run.csv", "--limits", "error") == 2
    assert "joint 1: position" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_velocities_and_accelerations_can_be_limited(far, tmp_path, capsys):
    simulate(far, tmp_path / "run.csv", "--max-velocity", "10,10,1.5", "--max-acceleration", "5,50,500")
    lines = warnings(capsys)
    assert [line for line in lines if "joint 3: velocity" in line]
    assert [line for line in lines if "joint 1: acceleration" in line]
    assert not [line for line in lines if "joint 2" in line or "joint 1: velocity" in line]
