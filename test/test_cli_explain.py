# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim explain`: what it passes on, writes and refuses; the analysis has tests of its own."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from cli_support import call
from loop_support import EXPLANATIONS, faulty, named

from puma_sim_core import executors
from puma_sim_core import identify as loop
from puma_sim_core.identify.result import Agreement


@pytest.fixture
def asked(monkeypatch, tmp_path_factory):
    """What the analysis was asked for, in a folder with logs that it does not read; it gives `asked["gives"]`."""
    monkeypatch.chdir(tmp_path_factory.mktemp("logs"))
    for name in "abcd":
        Path(f"{name}.csv").touch()
    seen = {"gives": named()}

    def explain(
        logs,
        *,
        held_out=(),
        plant="puma560",
        parameters=None,
        model=None,
        columns=None,
        seed=0,
        strict=False,
        agreement=True,
        progress=None,
    ):
        seen.update(
            logs=logs,
            held_out=held_out,
            plant=plant,
            parameters=parameters,
            model=model,
            columns=columns,
            seed=seed,
            strict=strict,
            agreement=agreement,
        )
        progress("screening", 0.5)
        return seen["gives"]

    monkeypatch.setattr(loop, "explain", explain, raising=False)
    return seen


def test_options_go_to_the_analysis_and_files_come_out(asked, tmp_path, capsys):
    out = tmp_path / "new" / "report"
    assert (
        call(
            "explain",
            "a.csv",
            "b.csv",
            "--held-out",
            "c.csv",
            "d.csv",
            "--out",
            out,
            "--plant",
            "pendulum",
            "--columns",
            "time=t_s, voltage1=motor_V",
            "--columns",
            "position1=q=rad",
            "--seed",
            "7",
            "--model",
            "m.yaml",
        )
        == 0
    )
    assert asked["logs"] == ["a.csv", "b.csv"] and asked["held_out"] == ["c.csv", "d.csv"]
    assert asked["agreement"]
    assert (asked["plant"], asked["model"], asked["seed"]) == ("pendulum", "m.yaml", 7)
    assert asked["columns"] == {"time": "t_s", "voltage1": "motor_V", "position1": "q=rad"}
    shown = capsys.readouterr()
    assert shown.out.splitlines() == [
        named().sentence,
        *(str(out / name) for name in ("report.json", "report.html", "model.yaml")),
    ]
    assert json.loads((out / "report.json").read_text())["verdict"] == "NAMED"


def test_the_comparison_of_logs_is_printed_and_can_be_left_out(asked, tmp_path, capsys):
    asked["gives"] = replace(named(), agreement=Agreement(("a", "b"), ("NAMED", "NAMED"), (), "Both name friction."))
    assert call("explain", "a.csv", "b.csv", "--no-agreement", "--out", tmp_path) == 0
    assert asked["agreement"] is False
    assert capsys.readouterr().out.splitlines()[:2] == [named().sentence, "Both name friction."]


@pytest.mark.parametrize(("threads", "logs", "processes"), [(1, "ab", 0), (2, "a", 0), (2, "abc", 1), (8, "abc", 3)])
def test_logs_are_explained_one_by_one_on_the_cores_that_are_left(
    threads, logs, processes, asked, tmp_path, monkeypatch
):
    monkeypatch.setenv("PUMA_SIM_THREADS", str(threads))
    opened = []
    monkeypatch.setattr(executors, "open_executor", lambda jobs: opened.append(jobs) or nullcontext("processes"))
    assert call("explain", *(f"{name}.csv" for name in logs), "--out", tmp_path) == 0
    assert opened == ([processes] if processes else [])
    assert asked["agreement"] == ("processes" if processes else True)


def test_defaults(asked, tmp_path):
    assert call("explain", "a.csv", "--out", tmp_path) == 0
    assert [asked[name] for name in ("held_out", "plant", "parameters", "model", "columns", "seed")] == [
        [],
        "puma560",
        None,
        None,
        None,
        0,
    ]


def test_the_report_is_printed_as_json(asked, tmp_path, capsys):
    assert call("explain", "a.csv", "--json") == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "NAMED"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", EXPLANATIONS)
def test_every_verdict_but_a_fault_of_the_data_is_a_success(name, asked, tmp_path, capsys):
    asked["gives"] = EXPLANATIONS[name]()
    assert call("explain", "a.csv", "--out", tmp_path) == (3 if asked["gives"].verdict == "DATA_FAULT" else 0)
    assert capsys.readouterr().out.startswith(asked["gives"].sentence)
    assert (tmp_path / "model.yaml").exists() == (asked["gives"].model is not None)


def test_a_fault_leaves_no_model_of_an_earlier_record(asked, tmp_path):
    assert call("explain", "a.csv", "--out", tmp_path) == 0
    asked["gives"] = faulty()
    assert call("explain", "a.csv", "--out", tmp_path) == 2
    assert (tmp_path / "model.yaml").exists()
    assert call("explain", "a.csv", "--out", tmp_path, "--force") == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "report.json"]


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["a.csv", "--seed", "x"], "--seed: 'x'; expected a whole number, 0 or more"),
        (["a.csv", "--seed", "-1"], "--seed: '-1'; expected a whole number, 0 or more"),
        (["a.csv", "--columns", "time"], "--columns: 'time'; expected OURS=THEIRS"),
        (["a.csv", "--columns", "time=,voltage1=u"], "--columns: 'time='; expected OURS=THEIRS"),
        (["a.csv", "--columns", "torque1=x"], "--columns: unknown column 'torque1'; expected"),
        (["a.csv", "--columns", "positon2=x"], "unknown column 'positon2'; expected position2 or"),
        (["a.csv", "--columns", "voltage0=x"], "--columns: unknown column 'voltage0'"),
        (["a.csv", "--columns", "time=t,time=u"], "--columns: 'time' is given twice"),
        (["a.csv", "--columns", "time=t,voltage1=t"], "--columns: 't' is given for two columns"),
        (["a.csv", "b.csv", "./a.csv"], "./a.csv: stands twice; expected each log once"),
        (["a.csv", "--held-out", "a.csv"], "a.csv: is to be fitted and held out"),
    ],
)
def test_refused_with_what_and_where(arguments, message, asked, tmp_path, capsys):
    assert call("explain", *arguments, "--out", tmp_path / "out") == 2
    assert message in capsys.readouterr().err
    assert "logs" not in asked and not (tmp_path / "out").exists()


def test_the_folder_is_checked_before_the_work(asked, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert call("explain", "a.csv", "--out", tmp_path / "file") == 2
    assert "file: is a file; expected a folder" in capsys.readouterr().err
    model = tmp_path / "model.yaml"
    model.write_text("")
    assert call("explain", "a.csv", "--model", model, "--out", tmp_path) == 2
    assert "is an input and would be overwritten" in capsys.readouterr().err
    assert "logs" not in asked


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--out", "x"],
        ["a.csv", "--out", "x", "--parameters", "bejczy", "--model", "m"],
        ["a.csv", "--out", "x", "--held-out"],
    ],
)
def test_wrong_command_lines(arguments, asked, capsys):
    with pytest.raises(SystemExit) as stop:
        call("explain", *arguments)
    assert stop.value.code == 2 and "usage: puma-sim explain" in capsys.readouterr().err
