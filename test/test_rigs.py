# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bench of real machines: its list, its judgement on answers made by hand, and its program."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigs import run as program
from rigs.catalogue import RIGS, Expected, Size, read_rigs
from rigs.jobs import Job, in_a_process
from rigs.judging import flipped, judge
from rigs.logs import Table, write_table
from rigs.table import json_of, markdown_of, page_of, row_of
from rigs_support import effect, outcome, report

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.result import VERDICTS
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

DATA = os.environ.get("PUMA_SIM_DATA")
BENCH = read_rigs()
RUNS = [run for rig in BENCH.values() for run in rig.runs]

# ----------------------------------------------------------------------------------------------------------- the list


def test_the_bench_has_all_machines_of_the_measured_data():
    assert list(BENCH) == [
        "xl330",
        "emps",
        "dfki_simple_pendulum",
        "dfki_double_a0",
        "dfki_double_c0",
        "dfki_double_c1",
        "qube",
        "so101",
        "so101_rotation",
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
    # a folder may have the logs of several machines
    beside = [other for other in BENCH.values() if other.folder == rig.folder]
    assert there == {file for other in beside for file in (*other.development_logs, *other.test_logs)}
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
        (report("DATA_FAULT", faults=["voltage1"]), Expected(("DATA_FAULT",), faults=("voltage1",)), "right"),
        (report("DATA_FAULT", faults=["time"]), Expected(("DATA_FAULT",), faults=("voltage1",)), "wrong"),
        (report("UNNAMED"), Expected(("UNNAMED", "DATA_FAULT"), faults=("voltage1",)), "right"),
        (
            report("NAMED", effect("coulomb_friction", 1)),
            Expected(("NAMED",), names=(("coulomb_friction@1",), ("payload",))),
            "wrong",
        ),
        (report("UNNAMED", shape=("time", 1)), Expected(("UNNAMED",), names=(("impulse@1", "shape:time@1"),)), "right"),
        (report("UNNAMED", shape=("time", 2)), Expected(("UNNAMED",), names=(("impulse@1", "shape:time@1"),)), "wrong"),
        # which of several pushes it is says no expectation
        (
            report("NAMED", effect("impulse_2", 1), effect("coulomb_friction", 1)),
            Expected(("NAMED",), names=(("impulse@1",),), wrong=("impulse@2",)),
            "right",
        ),
        (report("NAMED", effect("impulse_3", 2)), Expected(("NAMED",), names=(("impulse@1",),)), "wrong"),
        (report("NAMED", effect("impulse_3", 2)), Expected(("NAMED",), wrong=("impulse@2",)), "wrong"),
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


def test_a_run_is_asked_for_by_its_name_or_by_that_of_its_folder(tmp_path, data, monkeypatch):
    path, asked, answer = small_list(tmp_path), [], outcome(report("NAMED", effect("coulomb_friction", 1)))
    path.write_text(path.read_text().replace("name: two,", "name: 'two, held out',"))
    monkeypatch.setattr(program, "in_a_process", lambda job, limit: asked.append(job.name) or answer)
    for number, text in enumerate(("two, held", "tiny/two, held out", "two-held-out")):
        (tmp_path / str(number)).mkdir()
        program.main(["--out", str(tmp_path / str(number)), "--rigs", str(path), "--data", str(data), "--run", text])
    assert asked == ["tiny/two-held-out"] * 3


@pytest.mark.parametrize("role, explained", [("development", ["tiny/one"]), ("test", ["tiny/two"])])
def test_runs_of_one_role_leave_the_others_alone(role, explained, tmp_path, data, monkeypatch):
    path, asked, answer = small_list(tmp_path), [], outcome(report("NAMED", effect("coulomb_friction", 1)))
    path.write_text(path.read_text().replace("role: development, logs: [absent.csv]", "role: test, logs: [t.csv]"))
    monkeypatch.setattr(program, "in_a_process", lambda job, limit: asked.append(job.name) or answer)
    bench(tmp_path, data, "--role", role)
    assert asked == explained


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
        (("--run", "tidal"), "no run with 'tidal'"),
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


def test_the_starting_point_in_the_documentation_has_every_run():
    text = RIGS.parents[2].joinpath("docs", "rigs_start.md").read_text(encoding="utf-8")
    for rig in BENCH.values():
        assert f"(`{rig.name}`)" in text
    for run in RUNS:
        assert f"| {run.name} |" in text, run.key
