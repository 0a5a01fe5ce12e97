# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim explain-many` and `merge`: the same bytes for any number of workers, resuming, shards, errors as rows."""

from __future__ import annotations

import csv
import json
import os
import shutil
import sys
from math import erfc
from pathlib import Path

import numpy as np
import pytest
from cli_support import ROOT, call, complaints, contents, puma_sim

sys.path.insert(0, str(ROOT / "examples"))
import make_logs

from puma_sim_core.executors import Failure
from puma_sim_core.identify.several.many import AGREEMENT, compared
from puma_sim_core.result_folder import ResultFolder

PLANT = ("--plant", "pendulum")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A log with friction that the model lacks, one of a frozen encoder, and one that cannot be read."""
    folder = tmp_path_factory.mktemp("logs")
    time, voltage, position = make_logs.record(
        "pendulum", ("coulomb_friction:joint=1,torque=0.03",), 7, **make_logs.PENDULUM
    )
    make_logs.write(folder / "friction.csv", time[:1000], voltage[:1000], position[:1000])
    make_logs.write(folder / "frozen.csv", time, voltage, 0.0 * position)
    (folder / "unreadable.csv").write_text("time,voltage1\n0,0\n")
    return [str(path) for path in sorted(folder.iterdir())]


def explain_many(logs, out, *options, **environment):
    return puma_sim("explain-many", *logs, "--out", out, *PLANT, *options, **environment)


@pytest.fixture(scope="module")
def alone(logs, tmp_path_factory):
    """What one worker makes."""
    out = tmp_path_factory.mktemp("alone") / "out"
    done = explain_many(logs, out, "--jobs", 1)
    assert done.returncode == 0, done.stderr
    assert complaints(done) == [f"puma-sim: {logs[2]}: {error_of(out)}"]
    return out


def error_of(out):
    return json.loads((out / "unreadable" / "error.json").read_text())["error"]


def test_each_log_has_a_folder_and_a_line(alone, logs):
    assert sorted(os.listdir(alone)) == ["agreement.csv", "friction", "frozen", "run.json", "summary.csv", "unreadable"]
    assert sorted(os.listdir(alone / "friction")) == ["model.yaml", "report.html", "report.json"]
    rows = list(csv.DictReader((alone / "summary.csv").open(newline="")))
    assert [row["log"] for row in rows] == logs
    assert [row["verdict"] for row in rows] == ["NAMED", "DATA_FAULT", ""]
    assert rows[0]["effects"].startswith("coulomb_friction:joint=1,torque=0.0")
    assert float(rows[0]["augmented_V"]) < float(rows[0]["retuned_V"]) < float(rows[0]["nominal_V"])
    assert [bool(row["error"]) for row in rows] == [False, False, True]
    assert rows[2]["error"].startswith(logs[2]) and "position1" in rows[2]["error"]


def test_logs_that_agree_and_logs_that_do_not(tmp_path):
    def report(torque, half):
        parameter = {"value": torque, "ci95": [torque - half, torque + half], "unit": "N.m"}
        effect = {"name": "coulomb_friction", "joint": 1, "parameters": {"torque": parameter}, "tied_with": []}
        return json.dumps({"verdict": "NAMED", "effects": [effect], "detectability": []})

    half = 1.959964 * 0.1  # of a standard error of 0.1
    for values, agree in (((1.0, 1.2), True), ((1.0, 1.4), False)):
        jobs = [{"name": f"log{n}", "source": f"log{n}.csv", "sha256": ""} for n in range(3)]
        folder = ResultFolder(tmp_path / str(agree), {"command": "explain-many", "settings": {}, "jobs": jobs})
        folder.begin()
        for job, value in zip(jobs, values):
            folder.write(job["name"], {"report.json": report(value, half)})
        folder.write("log2", Failure("cannot be read"))
        sentence, (row,) = compared(folder)
        row = dict(zip(AGREEMENT, row))
        assert [row[key] for key in ("effect", "joint", "named", "tied", "logs", "unit")] == [
            *("coulomb_friction", "1", "2", "0", "3", "N.m")
        ]
        # by hand: Q = (difference / (0.1 sqrt 2))^2, p of one degree of freedom is erfc(sqrt(Q / 2))
        q = ((values[1] - values[0]) / 0.1) ** 2 / 2.0
        assert float(row["Q"]) == pytest.approx(q, rel=1e-4) and float(row["mean"]) == pytest.approx(np.mean(values))
        assert float(row["p"]) == pytest.approx(erfc((q / 2.0) ** 0.5), rel=1e-3)
        assert ("exclude each other" in sentence) == (not agree)


def test_the_effects_of_a_line_can_be_simulated(alone, tmp_path):
    rows = list(csv.DictReader((alone / "summary.csv").open(newline="")))
    assert call("model", "--effect", rows[0]["effects"], "--out", tmp_path / "model.yaml") == 0


@pytest.mark.long
def test_a_report_is_that_of_explain_but_for_the_time_that_it_took(alone, logs, tmp_path):
    done = puma_sim("explain", logs[0], *PLANT, "--out", tmp_path, OPENBLAS_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr
    one, other = (json.loads((path / "report.json").read_text()) for path in (tmp_path, alone / "friction"))
    assert one.pop("seconds") > 0.0 and other.pop("seconds") == 0.0
    assert one == other
    assert (tmp_path / "model.yaml").read_bytes() == (alone / "friction" / "model.yaml").read_bytes()


@pytest.mark.long
def test_forty_workers_give_the_same_bytes(alone, logs, tmp_path):
    assert explain_many(logs, tmp_path / "out", "--jobs", 40).returncode == 0
    assert contents(tmp_path / "out") == contents(alone)


@pytest.mark.long
def test_a_dask_cluster_gives_the_same_bytes(alone, logs, tmp_path):
    distributed = pytest.importorskip("dask.distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        done = explain_many(logs, tmp_path / "out", "--scheduler", cluster.scheduler_address)
    assert done.returncode == 0, done.stderr
    assert contents(tmp_path / "out") == contents(alone)


@pytest.mark.long
def test_a_run_goes_on_where_it_stopped(alone, logs, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(alone, out)
    for name in ("frozen", "unreadable"):
        shutil.rmtree(out / name)
    (out / "summary.csv").unlink()
    before = (out / "friction" / "report.json").stat().st_ino
    done = explain_many(logs, out)
    assert done.returncode == 0, done.stderr
    assert contents(out) == contents(alone)
    assert (out / "friction" / "report.json").stat().st_ino == before


@pytest.mark.long
def test_shards_are_merged_to_the_same_bytes(alone, logs, tmp_path):
    done = explain_many(logs, tmp_path / "1", "--shard", "1/2")
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "1" / "summary.csv").exists()
    early = puma_sim("merge", tmp_path / "1", "--out", tmp_path / "out")
    assert early.returncode == 2 and "frozen.csv" in early.stderr and not (tmp_path / "out").exists()
    assert explain_many(logs, tmp_path / "2", "--shard", "2/2").returncode == 0
    assert call("merge", tmp_path / "2", tmp_path / "1", "--out", tmp_path / "out") == 0
    assert contents(tmp_path / "out") == contents(alone)
    # into one folder, and merged in place
    shutil.copytree(tmp_path / "1" / "friction", tmp_path / "2" / "friction")
    shutil.copytree(tmp_path / "1" / "unreadable", tmp_path / "2" / "unreadable")
    assert call("merge", tmp_path / "2") == 0
    assert contents(tmp_path / "2") == contents(alone)


DEADLY = """
import multiprocessing, os
from dataclasses import replace
from puma_sim_core.effects.viscous_friction import EFFECT as MODEL
if multiprocessing.parent_process() is not None and os.path.exists({flag!r}):
    os._exit(7)
EFFECT = replace(MODEL, name="deadly_friction", look_alikes=(), screening=None)
"""


@pytest.mark.long
def test_a_worker_that_dies_is_a_line_and_is_tried_again(logs, tmp_path):
    flag = tmp_path / "flag"
    flag.touch()
    effect = tmp_path / "deadly_friction.py"
    effect.write_text(DEADLY.format(flag=str(flag)))
    out = tmp_path / "out"
    plain = {"PUMA_SIM_KERNEL": "python"}  # an effect of one's own would be compiled first
    done = explain_many(logs[1:2], out, "--effects", effect, **plain)
    assert done.returncode == 1, done.stderr
    (row,) = csv.DictReader((out / "summary.csv").open(newline=""))
    assert row["error"] == "the worker process ended with status 7"
    assert not (out / "frozen").exists()
    flag.unlink()
    done = explain_many(logs[1:2], out, "--effects", effect, **plain)
    assert done.returncode == 0, done.stderr
    (row,) = csv.DictReader((out / "summary.csv").open(newline=""))
    assert (row["verdict"], row["error"]) == ("DATA_FAULT", "")


# -- bad input ------------------------------------------------------------------------------------


def refused(capsys, *arguments) -> str:
    assert call(*arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


@pytest.mark.parametrize(
    "options, said",
    [
        (("--seed", "5"), "seed was 0, and is 5 now"),
        (("--strict",), "strict was False, and is True now"),
        (("--columns", "time=t"), "columns was not given"),
        (("--plant", "slide"), "plant was pendulum, and is slide now"),
    ],
)
def test_a_folder_of_another_run(alone, logs, capsys, options, said):
    before = contents(alone)
    assert said in refused(capsys, "explain-many", *logs, *PLANT, *options, "--out", alone)
    assert contents(alone) == before


def test_a_folder_of_other_logs(alone, logs, capsys, tmp_path):
    line = refused(capsys, "explain-many", *logs[:2], *PLANT, "--out", alone)
    assert f"has {logs[2]}, which is not given now" in line
    changed = tmp_path / "frozen.csv"
    changed.write_text(Path(logs[1]).read_text() + "20.0,0.0,0.0\n")
    line = refused(capsys, "explain-many", logs[0], changed, logs[2], *PLANT, "--out", alone)
    assert "has changed since" in line


def test_logs_that_cannot_have_folders_of_their_own(logs, capsys, tmp_path):
    other = tmp_path / "Friction.csv"
    shutil.copy(logs[0], other)
    out = tmp_path / "out"
    for given, said in (
        ([logs[0], other], f"has the name of {logs[0]}"),
        ([logs[0], logs[0]], "stands twice"),
        ([logs[0], tmp_path / "none.csv", tmp_path / "neither.csv"], "there is no such file, nor 1 of the other 2"),
    ):
        assert said in refused(capsys, "explain-many", *given, *PLANT, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    "options, said",
    [
        (("--jobs", "0"), "--jobs"),
        (("--jobs", "two"), "--jobs"),
        (("--shard", "3/2"), "--shard"),
        (("--seed", "-1"), "--seed"),
        (("--plant", "none"), "none"),
        (("--scheduler", "tcp://127.0.0.1:9"), "scheduler tcp://127.0.0.1:9: no answer"),
    ],
)
def test_options_that_cannot_be_used(logs, capsys, tmp_path, options, said):
    if "--scheduler" in options:
        pytest.importorskip("dask.distributed")
    assert said in refused(capsys, "explain-many", *logs, "--out", tmp_path / "out", *options)
    assert not list(tmp_path.glob("out/*/"))


def test_options_that_contradict_each_other(logs, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        call("explain-many", *logs, "--out", tmp_path, "--jobs", 2, "--scheduler", "tcp://127.0.0.1:9")
    assert end.value.code == 2 and "not allowed with" in capsys.readouterr().err


def test_folders_that_are_no_runs(alone, logs, capsys, tmp_path):
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "mine.txt").write_text("mine")
    assert "is not empty" in refused(capsys, "explain-many", *logs, *PLANT, "--out", taken)
    assert os.listdir(taken) == ["mine.txt"]
    assert "cannot be made" in refused(capsys, "explain-many", *logs, *PLANT, "--out", taken / "mine.txt")
    assert "no run.json" in refused(capsys, "merge", taken)
    assert "no --out" in refused(capsys, "merge", alone, taken)
    assert "stands twice" in refused(capsys, "merge", alone, alone, "--out", tmp_path / "out")
    (taken / "run.json").write_text('{"command": "explain-many"')
    assert "run.json cannot be used" in refused(capsys, "merge", taken)


def test_merging_results_that_differ(alone, capsys, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(alone, other)
    (other / "friction" / "report.html").write_text("else")
    assert "differs from" in refused(capsys, "merge", alone, other, "--out", tmp_path / "out")
    run = json.loads((other / "run.json").read_text())
    run["settings"]["seed"] = 9
    (other / "run.json").write_text(json.dumps(run))
    assert "seed was 9, and is 0 now" in refused(capsys, "merge", alone, other, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert ResultFolder.opened(other).run["settings"]["seed"] == 9
