# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bench of real machines: its list, its judgement on answers made by hand, its variants, and its program."""

from __future__ import annotations

import gzip
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs import run as program
from rigs.catalogue import RIGS, Expected, Log, Size, read_rigs
from rigs.jobs import Job, in_a_process
from rigs.judging import flipped, judge
from rigs.logs import Table, as_file, read_table, table_of, write_table
from rigs.table import json_of, markdown_of, page_of, row_of
from rigs.variants import (
    FAST,
    NOISE,
    PAUSE,
    SHIFT,
    VARIANTS,
    Given,
    command_in_thousandths,
    every_second_row,
    held_out_added,
    held_out_removed,
    logs_concatenated,
    logs_reversed,
    mirrored,
    noise_added,
    position_in_millimetres,
    time_shifted,
    unit_power,
)

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml
from puma_sim_core.identify.result import VERDICTS
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.one_joint import OneJoint, OneJointPlant
from puma_sim_core.resources import config_path
from puma_sim_core.simulation.simulator import Simulator

DATA = os.environ.get("PUMA_SIM_DATA")
BENCH = read_rigs()
RUNS = [run for rig in BENCH.values() for run in rig.runs]
MECHANISMS = {name: read_yaml(config_path("mechanisms", f"{name}.yaml")) for name in ("pendulum", "slide")}

# ----------------------------------------------------------------------------------------------------------- the list


def test_the_bench_has_all_machines_of_the_measured_data():
    assert list(BENCH) == [
        "xl330",
        "emps",
        "dfki_simple_pendulum",
        "dfki_double_pendulum",
        "qube",
        "so101",
        "kuka",
        "other_generator",
    ]
    for rig in BENCH.values():
        assert (rig.mechanism is None) == (rig.needs is not None)
        if rig.mechanism is not None:
            load_mechanism(rig.mechanism)


@pytest.mark.parametrize("rig", BENCH.values(), ids=lambda rig: rig.name)
def test_half_of_the_logs_of_a_machine_may_be_looked_at(rig):
    development, test = set(rig.development_logs), set(rig.test_logs)
    assert not development & test
    # where there is one log alone, and of records that were given for development, there is no other half
    if test:
        assert abs(len(development) - len(test)) <= 1
        assert {run.role for run in rig.runs} == {"development", "test"}
    used = {Path(log.file).name for run in rig.runs for log in (*run.logs, *run.held_out)}
    assert used <= development | test
    for run in rig.runs:
        names = {Path(log.file).name for log in (*run.logs, *run.held_out, *run.spare)}
        assert run.role == ("test" if names & test else "development"), run.key


@pytest.mark.skipif(DATA is None, reason="PUMA_SIM_DATA names no folder")
@pytest.mark.parametrize("rig", BENCH.values(), ids=lambda rig: rig.name)
def test_every_log_of_a_machine_is_there_and_has_its_columns(rig):
    files = [*rig.development_logs, *rig.test_logs]
    assert all(Path(DATA, rig.folder, file).is_file() for file in files)
    there = {path.name for path in Path(DATA, rig.folder).iterdir() if path.name.endswith((".csv", ".csv.gz"))}
    assert there == set(files)
    if rig.columns is not None:
        content = Path(DATA, rig.folder, files[0]).read_text(encoding="utf-8").splitlines()
        names = next(line for line in content if not line.startswith("#")).split(",")
        assert set(rig.columns.values()) <= set(names)


@pytest.mark.parametrize("run", RUNS, ids=lambda run: run.key)
def test_expected_answers_are_of_effects_and_parameters_that_there_are(run):
    expected = run.expected
    assert expected.verdicts and set(expected.verdicts) <= set(VERDICTS) and expected.sure
    tokens = [name for names in expected.names for name in names]
    for text in (*tokens, *expected.beside, *expected.wrong):
        _check_token(text)
    assert not set(tokens) & set(expected.wrong)
    for size in expected.sizes:
        name, _, parameter = size.of.rpartition(".")
        _check_token(name)
        assert parameter in [p.name for p in KINDS[name.partition("@")[0]].parameters]
        assert all(low <= high for low, high in size.intervals)


def _check_token(text):
    name, _, joint = text.partition("@")
    if not name.startswith("shape:"):
        assert KINDS[name].per_joint == bool(joint), text
    assert not joint or int(joint) >= 1


def test_all_three_ways_of_splitting_are_there():
    for name in ("xl330", "emps", "dfki_simple_pendulum", "other_generator"):
        splits = {run.split for run in BENCH[name].runs}
        assert splits == {"one log, blocks", "several logs, blocks", "held-out logs"}, name
    marked = [run for run in RUNS if run.variants]
    assert [run.rig for run in marked] == ["xl330", "emps", "dfki_simple_pendulum"]
    assert all(run.role == "development" for run in marked)


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("role: development", "role: exam", "role"),
        ("logs: [a.csv]", "logs: [b.csv]", "development_logs"),
        ("logs: [a.csv]", "logs: []", "one at least"),
        ("mechanism: pendulum", "mechanism: pendulum\n    needs: more", "one of the two"),
        ("sure: [fit]", "sure: [guess]", "sure"),
        ("logs: [a.csv]", "logs: [t.csv]", "test"),
    ],
)
def test_errors_of_the_list_name_the_key(tmp_path, old, new, words):
    path = small_list(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ParameterError, match=words):
        read_rigs(path)


def small_list(folder, mechanism="pendulum", variants="false"):
    path = folder / "rigs.yaml"
    path.write_text(
        f"""format: puma-sim rigs 1
rigs:
  tiny:
    title: A pendulum
    folder: tiny
    source: made here
    mechanism: {mechanism}
    development_logs: [a.csv, absent.csv]
    test_logs: [t.csv]
    runs:
      - name: one
        role: development
        logs: [a.csv]
        variants: {variants}
        expected: {{verdicts: [NAMED], names: [[coulomb_friction@1]], beside: [voltage_offset@1], sure: [fit]}}
      - {{name: two, role: development, logs: [absent.csv], expected: {{verdicts: [NAMED], sure: [fit]}}}}
  other:
    title: A crane
    folder: crane
    source: nobody
    needs: ropes
    development_logs: [c.csv]
    runs:
      - {{name: lift, role: development, logs: [c.csv], expected: {{verdicts: [UNNAMED], sure: [fit]}}}}
"""
    )
    return path


# --------------------------------------------------------------------------------------------------- answers by hand


def effect(name, joint, ties=(), **sizes):
    return {
        "name": name,
        "joint": joint,
        "evidence": 50.0,
        "tied_with": [{"name": n, "joint": j} for n, j in ties],
        "ruled_out": [],
        "parameters": {key: {"value": v, "ci95": [low, high], "unit": "1"} for key, (v, low, high) in sizes.items()},
    }


def report(verdict, *effects, shape=None):
    stages = {stage: [1.0] for stage in ("nominal", "retuned", "augmented", "floor")}
    return {
        "verdict": verdict,
        "sentence": "x",
        "effects": list(effects),
        "shape": None if shape is None else {"axis": shape[0], "joint": shape[1], "way": "", "line_hz": None},
        "errors": {"fit": None, "held_out": {"voltage_rms": stages, "position_rms": stages}, "unseen": None},
        "position_unit": "rad",
        "voltage_unit": "V",
        "faults": [],
    }


def outcome(given_report, **more):
    return {
        "report": given_report,
        "error": None,
        "applies": True,
        "seconds": 3.0,
        "megabytes": 9,
        "ours": None,
        **more,
    }


FRICTION = (("coulomb_friction@1", "stribeck_friction@1"),)
WANTED = Expected(("NAMED",), names=FRICTION, wrong=("backlash@1",), sure=("fit",))


@pytest.mark.parametrize(
    "answer, expected, mark",
    [
        (report("NAMED", effect("coulomb_friction", 1)), WANTED, "right"),
        (report("NAMED", effect("stribeck_friction", 1)), WANTED, "right"),
        (report("NAMED", effect("coulomb_friction", 2)), WANTED, "wrong"),
        (report("NAMED_WITH_REMAINDER", effect("coulomb_friction", 1), shape=("time", 1)), WANTED, "wrong"),
        (report("NAMED", effect("coulomb_friction", 1), effect("backlash", 1)), WANTED, "wrong"),
        (report("NAMED", effect("coulomb_friction", 1), effect("payload", None)), WANTED, "right"),
        (
            report("NAMED", effect("coulomb_friction", 1), effect("payload", None)),
            replace(WANTED, others_wrong=True),
            "wrong",
        ),
        (
            report("NAMED", effect("coulomb_friction", 1), effect("payload", None)),
            replace(WANTED, others_wrong=True, beside=("payload",)),
            "right",
        ),
        (report("NAMED", effect("backlash", 1, [("coulomb_friction", 1)])), WANTED, "cannot tell"),
        (report("NAMED", effect("backlash", 1, [("coulomb_friction", 2)])), WANTED, "wrong"),
        (report("UNNAMED", shape=("velocity", 1)), WANTED, "wrong"),
        (report("NOTHING_MISSING"), WANTED, "wrong"),
        (report("NOTHING_MISSING"), Expected(("NOTHING_MISSING",), others_wrong=True), "right"),
        (
            report("NAMED", effect("coulomb_friction", 1)),
            Expected(("NAMED",), names=(("coulomb_friction@1",), ("payload",))),
            "wrong",
        ),
        (report("UNNAMED", shape=("time", 1)), Expected(("UNNAMED",), names=(("impulse@1", "shape:time@1"),)), "right"),
        (report("UNNAMED", shape=("time", 2)), Expected(("UNNAMED",), names=(("impulse@1", "shape:time@1"),)), "wrong"),
        (None, WANTED, "error"),
    ],
)
def test_an_answer_is_right_wrong_or_open(answer, expected, mark):
    found = judge(answer, expected)
    assert found["mark"] == mark, found["why"]
    assert bool(found["why"]) == (mark in ("wrong", "cannot tell"))


@pytest.mark.parametrize(
    "value, low, high, right",
    [
        (0.2, 0.19, 0.21, True),
        (0.3, 0.29, 0.31, False),
        (0.3, 0.24, 0.36, True),  # the interval meets it
        (0.2, None, None, True),
        (0.9, None, 1.0, True),
        (0.1, 0.05, 0.14, False),
    ],
)
def test_a_published_size_is_met_by_the_estimate_or_its_interval(value, low, high, right):
    size = Size("coulomb_friction@1.torque", "0.15 to 0.25", ((0.15, 0.25),), "N.m", "someone", "fit")
    other = replace(size, of="stribeck_friction@1.torque")
    found = judge(
        report("NAMED", effect("coulomb_friction", 1, torque=(value, low, high))), replace(WANTED, sizes=(size, other))
    )
    assert (found["mark"] == "right") == right
    assert [each["of"] for each in found["sizes"]] == [size.of]  # of what is not named there is no size


def test_flips_are_of_names_joints_verdicts_and_sizes():
    base = outcome(report("NAMED", effect("coulomb_friction", 1, torque=(0.2, 0.15, 0.25))))

    def other(verdict="NAMED", name="coulomb_friction", joint=1, value=0.22):
        return outcome(report(verdict, effect(name, joint, torque=(value, 0.1, 0.3))))

    assert flipped(base, other(), "column_added") == []
    assert flipped(base, other(verdict="NAMED_WITH_REMAINDER"), "column_added") == ["NAMED became NAMED_WITH_REMAINDER"]
    assert flipped(base, other(joint=2), "column_added") == ["lost coulomb_friction@1", "gained coulomb_friction@2"]
    assert flipped(base, other(value=0.26), "column_added") == ["coulomb_friction@1.torque 0.2 became 0.26"]
    assert flipped(base, outcome(None, error="no"), "column_added") == ["error"]


def test_sizes_of_a_mirrored_machine_are_turned_back():
    one = effect("asymmetric_coulomb_friction", 1, positive=(17.0, 16.0, 18.0), negative=(23.0, 22.0, 24.0))
    two = effect("asymmetric_coulomb_friction", 1, positive=(23.1, 22.0, 24.0), negative=(17.1, 16.0, 18.0))
    offset = [effect("voltage_offset", 1, voltage=(v, v - 0.1, v + 0.1)) for v in (0.5, -0.5)]
    base, turned = outcome(report("NAMED", one, offset[0])), outcome(report("NAMED", two, offset[1]))
    assert flipped(base, turned, "mirrored") == []
    assert len(flipped(base, base, "mirrored")) == 3
    assert len(flipped(base, turned, "column_added")) == 3


# ----------------------------------------------------------------------------------------------------------- variants


def made(rows=40, rate=500.0, name="a", seed=0):
    random = np.random.default_rng(seed)
    time = np.arange(rows) / rate
    return Table(name, ("t", "u", "q", "on"), np.column_stack([time, random.normal(size=(rows, 2)), np.ones(rows)]))


COLUMNS = {"time": "t", "voltage1": "u", "position1": "q", "enable": "on"}
PLAIN = Given(
    (made(), made(30, name="b", seed=1)),
    (made(20, name="c", seed=2),),
    (made(20, name="d", seed=3),),
    COLUMNS,
    MECHANISMS["pendulum"],
    (0.4,),
)


def same(one, two):
    return one.names == two.names and np.array_equal(one.values, two.values)


def test_held_out_logs_come_and_go_and_nothing_else():
    more = held_out_added(PLAIN)
    assert [t.name for t in more.held_out] == ["c", "d"] and more.logs == PLAIN.logs
    assert held_out_added(replace(PLAIN, spare=())) is None
    less = held_out_removed(PLAIN)
    assert less.held_out == () and less.logs == PLAIN.logs
    assert held_out_removed(replace(PLAIN, held_out=())) is None


def test_the_order_of_logs_is_reversed():
    assert [t.name for t in logs_reversed(PLAIN).logs] == ["b", "a"]
    assert logs_reversed(replace(PLAIN, logs=PLAIN.logs[:1])) is None


def test_concatenated_logs_keep_their_rows_and_steps():
    (whole,) = logs_concatenated(PLAIN).logs
    first, second = PLAIN.logs
    assert len(whole) == len(first) + len(second)
    assert np.array_equal(whole.values[: len(first)], first.values)
    assert np.array_equal(whole.values[len(first) :, 1:], second.values[:, 1:])
    steps = np.diff(whole.column("t"))
    assert steps[len(first) - 1] == pytest.approx(PAUSE)
    assert np.delete(steps, len(first) - 1) == pytest.approx(1.0 / 500.0)
    assert logs_concatenated(replace(PLAIN, logs=PLAIN.logs[:1])) is None


def test_the_time_origin_moves_and_the_steps_stay():
    moved = time_shifted(PLAIN)
    for one, two in zip((*PLAIN.logs, *PLAIN.held_out), (*moved.logs, *moved.held_out)):
        assert np.array_equal(two.column("t"), one.column("t") + SHIFT)
        assert np.array_equal(two.values[:, 1:], one.values[:, 1:])


def test_mirroring_turns_positions_voltages_and_the_range():
    turned = mirrored(replace(PLAIN, mechanism=MECHANISMS["slide"]))
    for one, two in zip(PLAIN.logs, turned.logs):
        assert np.array_equal(two.values, one.values * [1.0, -1.0, -1.0, 1.0])
    assert turned.mechanism["range"]["value"] == [-0.30, 0.05]
    assert MECHANISMS["slide"]["range"]["value"] == [-0.05, 0.30]  # as it was
    assert mirrored(replace(PLAIN, mechanism=None)) is None
    again = mirrored(turned)
    assert all(map(same, again.logs, PLAIN.logs)) and again.mechanism == MECHANISMS["slide"]


def test_a_column_is_added_and_no_other_changes():
    changed = VARIANTS["column_added"].change(PLAIN)
    for one, two in zip(PLAIN.logs, changed.logs):
        assert two.names[:-1] == one.names and np.array_equal(two.values[:, :-1], one.values)


@given(st.integers(2, 60), st.sampled_from([100.0, 399.0, FAST + 1.0, 1000.0]))
def test_every_second_row_is_dropped_of_fast_logs_alone(rows, rate):
    table = made(rows, rate)
    changed = every_second_row(Given((table,), columns=COLUMNS))
    if rate < FAST:
        assert changed is None
    else:
        assert np.array_equal(changed.logs[0].values, table.values[::2])


def test_noise_is_a_tenth_of_the_floor_on_the_fitted_voltages_and_seeded():
    table = made(20000)
    one = noise_added(Given((table,), (table,), columns=COLUMNS, floor=(0.4,), seed=3))
    added = one.logs[0].values - table.values
    assert added[:, 1].std() == pytest.approx(NOISE * 0.4, rel=0.03)
    assert not added[:, [0, 2, 3]].any() and same(one.held_out[0], table)
    again, other = (noise_added(Given((table,), columns=COLUMNS, floor=(0.4,), seed=seed)) for seed in (3, 4))
    assert same(again.logs[0], one.logs[0]) and not same(other.logs[0], one.logs[0])
    assert noise_added(Given((table,), columns=COLUMNS)) is None


def simulated(mapping, volts, position):
    """(n,) positions of a machine, of which all numbers are as its file says."""
    time = 0.002 * np.arange(len(volts))
    simulator = Simulator(OneJointPlant.of(OneJoint.from_mapping(mapping)))
    simulator.reset([position])
    return simulator.run(time, volts[:, None]).position[:, 0]


@pytest.mark.parametrize("name", MECHANISMS)
@pytest.mark.parametrize(
    "change, scale", [(mirrored, -1.0), (command_in_thousandths, 1.0), (position_in_millimetres, 1e3)]
)
def test_a_machine_in_other_units_moves_as_before(name, change, scale):
    volts = 1.5 * np.sin(0.05 * np.arange(200))
    table = Table("a", ("t", "u", "q", "on"), np.column_stack([0.002 * np.arange(200), volts, volts, volts]))
    changed = change(Given((table,), columns=COLUMNS, mechanism=MECHANISMS[name]))
    if change is position_in_millimetres and name == "pendulum":
        assert changed is None
        return
    new = changed.logs[0]
    assert np.array_equal(new.column("q"), scale * table.column("q"))
    before = simulated(MECHANISMS[name], volts, 0.1)
    after = simulated(changed.mechanism, new.column("u"), 0.1 * scale)
    assert after == pytest.approx(scale * before, rel=1e-6, abs=1e-9 * abs(scale))
    # the priors are as wide in proportion as they were
    old, other = (OneJoint.from_mapping(m) for m in (MECHANISMS[name], changed.mechanism))
    for one, two in zip(old.parameters, other.parameters):
        assert two.known == one.known
        if one.value:
            assert two.deviation / two.value == pytest.approx(one.deviation / one.value)


def test_units_in_thousandths():
    powers = {"V": 1, "A": -1, "ohm": 2}
    for unit, power in (("V", 1), ("V.s/rad", 1), ("1/A", 1), ("N.m/A", 1), ("N.m", 0), ("1", 0), ("ohm", 2)):
        assert unit_power(unit, powers) == power
    assert unit_power("N.s2/m2", {"m": 1}) == -2
    for kind in KINDS.values():
        for parameter in kind.parameters:
            unit_power(parameter.unit, powers)
    one = effect("voltage_offset", 1, voltage=(0.5, 0.4, 0.6))
    one["parameters"]["voltage"]["unit"] = "V"
    two = effect("voltage_offset", 1, voltage=(510.0, 400.0, 600.0))
    two["parameters"]["voltage"]["unit"] = "V"
    base, changed = outcome(report("NAMED", one)), outcome(report("NAMED", two))
    assert flipped(base, changed, "command_in_thousandths") == []
    assert flipped(base, changed, "column_added") != []


@settings(max_examples=25)
@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 2), min_size=1, max_size=20))
def test_tables_are_read_as_they_were_written(tmp_path_factory, rows):
    folder = tmp_path_factory.mktemp("tables")
    table = Table("some log", ("t", "q"), np.array(rows))
    path = write_table(table, folder)
    packed = folder / "packed.csv.gz"
    packed.write_bytes(gzip.compress(b"# a comment\n" + path.read_bytes()))
    assert same(read_table(path), table) and same(read_table(packed), table)


def test_a_stretch_of_a_log_keeps_its_times(tmp_path):
    write_table(made(100), tmp_path)
    part = table_of(Log("a.csv", 0.05, 0.1), tmp_path, "t")
    assert part.column("t")[0] == 0.05 and len(part) == 25 and part.name == "a 0.05-0.1 s"
    assert as_file(Log("a.csv"), tmp_path, "t", tmp_path) == tmp_path / "a.csv"
    assert len(read_table(as_file(Log("a.csv", end=0.1), tmp_path, "t", tmp_path))) == 50


# -------------------------------------------------------------------------------------------------------- the program


@pytest.fixture
def data(tmp_path):
    """A folder with a log of a pendulum with dry friction."""
    folder = tmp_path / "data" / "tiny"
    folder.mkdir(parents=True)
    time = 0.005 * np.arange(800)
    volts = 1.6 * np.sin(2.1 * time) + 1.0 * np.sin(7.3 * time) + 0.3 * np.sin(31.0 * time)
    mechanism = load_mechanism("pendulum")
    simulator = Simulator(mechanism.plant(None, [parse_effect("coulomb_friction:joint=1,torque=0.05")]))
    simulator.reset([0.0])
    random = np.random.default_rng(5)
    position = simulator.run(time, volts[:, None]).position[:, 0] + 2e-4 * random.standard_normal(len(time))
    rows = np.column_stack([time, volts, position])
    write_table(Table("a", ("time", "voltage1", "position1"), rows), folder)
    return tmp_path / "data"


def bench(tmp_path, data, *more):
    out = tmp_path / "out"
    code = program.main(["--out", str(out), "--data", str(data), "--rigs", str(tmp_path / "rigs.yaml"), *more])
    return code, out


@pytest.mark.long
def test_the_bench_from_end_to_end(tmp_path, data, monkeypatch, capsys):
    small_list(tmp_path, variants="true")
    code, out = bench(tmp_path, data, "--invariances", "column_added,logs_reversed")
    assert code == 0
    rows = {row["key"]: row for row in json.loads((out / "rigs.json").read_text())["rows"]}
    one, two, lift = rows["tiny/one"], rows["tiny/two"], rows["other/lift"]
    assert one["mark"] == "right" and one["given"]["names"] == ["coulomb_friction@1"]
    assert one["errors"]["voltage_rms"]["augmented"] < one["errors"]["voltage_rms"]["retuned"]
    assert one["seconds"] > 0.0 and one["megabytes"] > 50
    assert one["flips"] == {"applied": ["column_added"], "flips": {}}
    # an error is a row
    assert two["mark"] == "error" and "absent.csv" in two["why"][0]
    assert lift["mark"] == "cannot be described yet" and lift["needs"] == "ropes"
    for name in ("report.json", "report.html", "model.yaml", "variants/column_added/report.html"):
        assert (out / "tiny" / "one" / name).is_file()
    page, text = (out / "rigs.html").read_text(), (out / "rigs.md").read_text()
    assert 'href="tiny/one/report.html"' in page and "needs ropes" in page
    assert "coulomb_friction@1" in text and "needs ropes" in text
    shown = capsys.readouterr().out
    assert "explaining tiny/one; 2 left" in shown and "1 right" in shown

    # again: nothing is explained twice, and the page is the same
    def not_again(job, limit):
        raise AssertionError(job.name)

    monkeypatch.setattr(program, "in_a_process", not_again)
    code, _ = bench(tmp_path, data, "--invariances", "column_added,logs_reversed")
    assert code == 0 and (out / "rigs.html").read_text() == page
    assert "2 runs, 2 of them explained before" in capsys.readouterr().out


def test_what_was_interrupted_goes_on_and_other_code_does_not_count(tmp_path, data, monkeypatch):
    small_list(tmp_path)
    asked = []

    def quick(job, limit):
        asked.append(job.name)
        return outcome(report("NAMED", effect("coulomb_friction", 1)))

    monkeypatch.setattr(program, "in_a_process", quick)
    _, out = bench(tmp_path, data, "--run", "one")
    kept = out / "outcomes.jsonl"
    kept.write_text(kept.read_text() + '{"code": "cut sho')
    bench(tmp_path, data)
    assert asked == ["tiny/one", "tiny/two"]
    assert json.loads((out / "rigs.json").read_text())["summary"] == {
        "development": {"right": 2, "cannot be described yet": 1}
    }
    monkeypatch.setattr(program, "fingerprint", lambda: "other")
    bench(tmp_path, data, "--quick", "--only", "tiny")
    assert asked == ["tiny/one", "tiny/two", "tiny/one"]
    rows = json.loads((out / "rigs.json").read_text())["rows"]
    assert [row["mark"] for row in rows] == ["right", "not measured yet", "cannot be described yet"]


def test_a_process_that_takes_too_long_or_dies_is_an_error_and_is_tried_again(tmp_path, data):
    path = small_list(tmp_path)
    rigs = read_rigs(path)
    job = Job.of(rigs["tiny"], rigs["tiny"].runs[0], data, tmp_path / "out")
    found = in_a_process(job, 0.05)
    assert found["report"] is None and "not finished" in found["error"] and found["megabytes"] is None
    (tmp_path / "kept").write_text(json.dumps({"code": "x", "key": job.key(), "outcome": found}) + "\n")
    assert program.kept_outcomes(tmp_path / "kept", "x") == {}
    row = row_of(rigs["tiny"], rigs["tiny"].runs[0], found, {})
    assert row["mark"] == "error" and row["why"] == [found["error"]]
    assert json.loads(json_of([row], "x"))["summary"] == {"development": {"error": 1}}
    assert "not finished" in page_of([rigs["tiny"]], [row], "x") and "not finished" in markdown_of(
        [rigs["tiny"]], [row]
    )


def test_wrong_use_is_said_and_explains_nothing(tmp_path, monkeypatch, capsys):
    small_list(tmp_path)
    monkeypatch.delenv("PUMA_SIM_DATA", raising=False)
    for more, words in (
        ((), "PUMA_SIM_DATA is not set"),
        (("--data", str(tmp_path / "nowhere")), "is no folder"),
        (("--only", "crane"), "no machine 'crane'"),
        (("--invariances", "upside_down"), "no invariance 'upside_down'"),
    ):
        given_data = () if "--data" in more or not more else ("--data", str(tmp_path))
        code = program.main(["--out", str(tmp_path / "out"), "--rigs", str(tmp_path / "rigs.yaml"), *given_data, *more])
        assert code == 2 and words in capsys.readouterr().err


def test_the_table_of_the_documentation_is_replaced(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{program.MARKERS[0]}\nold\n{program.MARKERS[1]}\nafter\n")
    program.put_table(page, "new\n")
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("\nafter\n") and "new" in text and "old" not in text


def test_the_page_of_the_documentation_has_every_run():
    text = RIGS.parents[2].joinpath("docs", "rigs.md").read_text(encoding="utf-8")
    for rig in BENCH.values():
        assert f"(`{rig.name}`)" in text
    for run in RUNS:
        assert f"| {run.name} |" in text, run.key
