# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs that are explained one by one beside the whole: the same reports, in their order, whoever makes them."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from puma_sim_core.errors import ParameterError
from puma_sim_core.executors import open_executor
from puma_sim_core.identify import explain
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.explain import _alone
from puma_sim_core.identify.report.json import report_text
from puma_sim_core.identify.several.one_by_one import OneByOne

PENDULUM = Path(__file__).parents[1] / "examples" / "pendulum.csv"


def logs() -> list[Log]:
    """One whose position does not move with its voltage, one that is too short, and one in degrees."""
    time = np.arange(0.0, 4.0, 0.01)
    swing = np.sin(3.0 * time)[:, None]
    return [
        Log("frozen", time, 2.0 * swing, 0.3 + 0.0 * swing),
        Log("short", time[:9], swing[:9], swing[:9]),
        Log("degrees", time, 2.0 * swing, 120.0 * swing),
    ]


def reports(executor) -> list:
    asked = {"plant": "pendulum", "parameters": None, "model": None, "seed": 3, "strict": False}
    found = OneByOne(logs(), partial(_alone, **asked), executor).reports(lambda what, share: None)
    for report in found:
        assert report.pop("seconds") > 0.0
    return found


def test_processes_give_the_reports_that_this_one_gives():
    here = reports(None)
    assert [report["verdict"] for report in here] == 3 * ["DATA_FAULT"]
    assert [report["logs"] for report in here] == [["frozen"], ["short"], ["degrees"]]
    with open_executor(2) as executor:
        assert reports(executor) == here


def where(log: Log, progress) -> dict:
    """The process that a log is explained in; the log `ends` ends any but that of the test."""
    if log.name == "ends" and os.environ["PUMA_SIM_TEST_PROCESS"] != str(os.getpid()):
        os._exit(3)
    progress(log.name, 1.0)
    return {"process": os.getpid()}


def test_a_log_whose_process_ends_is_explained_here(monkeypatch):
    monkeypatch.setenv("PUMA_SIM_TEST_PROCESS", str(os.getpid()))
    time, shown = np.arange(3.0), []
    own = [Log(name, time, time[:, None], time[:, None]) for name in ("first", "ends", "last")]
    with open_executor(1) as executor:
        found = OneByOne(own, where, executor).reports(lambda what, share: shown.append((what, share)))
    there = [report["process"] != os.getpid() for report in found]
    assert there == [True, False, True]
    # what is explained here says so, as the second of three
    assert ("ends", pytest.approx(2.0 / 3.0)) in shown


def refuse(log: Log, progress) -> None:
    raise ParameterError("no such plant", where="--plant", expected="one that there is")


@pytest.mark.parametrize("jobs", [0, 1])
def test_an_error_is_that_of_the_log(jobs):
    time = np.arange(3.0)
    log = Log("any", time, time[:, None], time[:, None])
    if not jobs:
        with pytest.raises(ParameterError, match="no such plant"):
            OneByOne([log], refuse).reports(lambda what, share: None)
        return
    with open_executor(jobs) as executor, pytest.raises(ParameterError, match="no such plant"):
        OneByOne([log], refuse, executor).reports(lambda what, share: None)


@pytest.mark.thorough
def test_an_explanation_with_processes_has_the_same_bytes(tmp_path):
    lines = PENDULUM.read_text().splitlines()
    paths = [tmp_path / "first.csv", tmp_path / "second.csv"]
    for path, own in zip(paths, (lines[1:1001], lines[1001:])):
        path.write_text("\n".join([lines[0], *own]) + "\n")

    def text(agreement) -> list[str]:
        found = report_text(explain(paths, plant="pendulum", agreement=agreement))
        return [line for line in found.splitlines() if not line.lstrip().startswith('"seconds"')]

    here = text(True)
    with open_executor(2) as executor:
        assert text(executor) == here
    assert any('"agreement"' in line for line in here)
