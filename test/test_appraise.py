# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim appraise`: controls, resuming, shards, controllers that misbehave, bags, the report and bad input."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from math import inf

import jsonschema
import numpy as np
import pytest
from linkage_support import LEVEL_DOWN, mechanism, torque_drive

from puma_sim_core.appraisal import appraise, battery, work
from puma_sim_core.appraisal.appraise import BatteryError, check_controls, run_battery
from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.controllers import make
from puma_sim_core.appraisal.perturbations.drawing import Conditions
from puma_sim_core.appraisal.report.output import write_report
from puma_sim_core.appraisal.settings import Patience
from puma_sim_core.appraisal.store import merge, open_store
from puma_sim_core.appraisal.trials.guard import Ended
from puma_sim_core.appraisal.trials.trial import Trial
from puma_sim_core.appraisal.work import Job, foreign_results, run_unit
from puma_sim_core.arm.kinematics import wrist_path
from puma_sim_core.cli import main
from puma_sim_core.cli.output import TimeLeft
from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.executors import Shard, open_executor
from puma_sim_core.files import read_yaml, write_yaml
from puma_sim_core.plant.linkage.linkage_file import linkage_mapping
from puma_sim_core.plant.model_file import dump_model
from puma_sim_core.resources import config_path
from puma_sim_core.simulation.replay import replay

SMALL = Battery(
    ("pid", "ziegler_nichols"),
    "quick",
    tasks=("small_step_1", "effects"),
    perturbations=("nominal", "noise", "coulomb_friction:2:large", "encoder_offset:1:large"),
    searches=False,
)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of the small battery, run on one process."""
    folder = tmp_path_factory.mktemp("board") / "one"
    with open_executor(1) as executor:
        results = run_battery(SMALL, folder, executor)
        write_report(SMALL, results, str(folder), 1)
    return folder


def contents(folder):
    return {name: (folder / name).read_bytes() for name in ("report.json", "report.html", "scoreboard.csv")}


@pytest.mark.long
def test_two_workers_and_merged_shards_give_the_same_bytes(done, tmp_path, capsys):
    with open_executor(2) as executor:
        results = run_battery(SMALL, tmp_path / "two", executor)
        write_report(SMALL, results, str(tmp_path / "two"), 1)
        for part in (1, 2):
            run_battery(SMALL, tmp_path / f"shard{part}", executor, Shard(part, 2))
        # all shards may share a folder
        for part in (2, 1):
            run_battery(SMALL, tmp_path / "shared", executor, Shard(part, 2))
    assert contents(tmp_path / "two") == contents(done)
    with pytest.raises(RecordingError, match="no result of"):
        merge([tmp_path / "shard1"], tmp_path / "half")
    assert not (tmp_path / "half").exists()
    folders = [str(tmp_path / f"shard{part}") for part in (1, 2)]
    assert main(["appraise", "merge", *folders, "--out", str(tmp_path / "all"), "--bags", "1"]) == 0
    assert contents(tmp_path / "all") == contents(done)
    assert main(["merge", str(tmp_path / "shared")]) == 0
    assert (tmp_path / "shared" / "scoreboard.csv").read_bytes() == contents(done)["scoreboard.csv"]
    capsys.readouterr()


@pytest.mark.long
def test_a_dask_cluster_gives_the_same_bytes(done, tmp_path):
    distributed = pytest.importorskip("dask.distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
        open_executor(scheduler=cluster.scheduler_address) as executor,
    ):
        results = run_battery(SMALL, tmp_path / "cluster", executor)
    write_report(SMALL, results, str(tmp_path / "cluster"), 1)
    assert contents(tmp_path / "cluster") == contents(done)


def test_the_report_follows_its_schema_and_a_bag_replays_to_the_last_bit(done):
    found = json.loads((done / "report.json").read_text())
    schema = json.loads(config_path("appraisal_report.schema.json").read_text())
    jsonschema.validate(found, schema)
    bags = [each["bag"] for each in found["failures"] if each["bag"]]
    assert bags and all(replay(done / bag).identical for bag in bags)
    assert len(bags) == len({each["controller"] for each in found["failures"]})


def test_a_bag_has_the_states_of_its_trial(done):
    from puma_sim_core.appraisal.battery import Group
    from puma_sim_core.appraisal.trials.replays import again
    from puma_sim_core.recording.bag import read_bag

    found = json.loads((done / "report.json").read_text())
    failure = next(each for each in found["failures"] if each["bag"])
    group = Group(failure["task"], failure["perturbation"], 1)
    response = again(SMALL, failure["controller"], group, failure["draw"]).response
    bag = read_bag(done / failure["bag"])
    assert np.array_equal(bag.velocity, response.velocity) and np.array_equal(bag.current, response.current)


def test_what_was_cut_off_is_done_again_and_no_unit_twice(done, tmp_path):
    folder = tmp_path / "again"
    shutil.copytree(done, folder)
    cut, *others = sorted((folder / "units").iterdir(), reverse=True)
    before = {path: (path / "result.json").stat().st_mtime_ns for path in others}
    cut.rename(folder / ".new-left-behind")
    with open_executor(1) as executor:
        assert run_battery(SMALL, folder, executor) == open_store(done, SMALL).results
    assert (cut / "result.json").read_bytes() == (done / "units" / cut.name / "result.json").read_bytes()
    assert {path: (path / "result.json").stat().st_mtime_ns for path in others} == before


@pytest.mark.long
def test_a_killed_battery_resumes(done, tmp_path):
    folder = tmp_path / "killed"
    names = [f"--task={name}" for name in SMALL.tasks] + [f"--perturbation={name}" for name in SMALL.perturbations]
    command = [sys.executable, "-m", "puma_sim_core", "appraise", *SMALL.controllers, "--profile", "quick", *names]
    command += ["--no-searches", "--out", str(folder), "--jobs", "1", "--bags", "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    while process.poll() is None and not (folder / "units").exists():
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    subprocess.run(command, check=True, capture_output=True)
    assert contents(folder) == contents(done)


def test_controls_stop_a_battery_whose_limits_or_plant_mean_nothing(tmp_path, monkeypatch):
    """Mutants: limits that nothing exceeds, and a plant that does not move."""
    setting = SMALL.setting
    loose = {
        name: replace(task, limits=tuple(limit._replace(value=inf) for limit in task.limits))
        for name, task in setting.tasks.items()
    }
    unit = next(unit for unit in SMALL.units if unit.control and unit.controller == battery.FAILS_ALL)
    with monkeypatch.context() as mutant:
        mutant.setattr(battery, "_setting", lambda *_: replace(setting, tasks=loose))
        with pytest.raises(BatteryError, match="do-nothing passes small_step_1, effects"):
            check_controls({0: run_unit(Job(SMALL, unit))})
    unit = next(unit for unit in SMALL.units if unit.control and unit.controller == battery.PASSES_ALL)
    with monkeypatch.context() as mutant:
        frozen = work.Trial._start

        def start(self):
            frozen(self)
            hold = lambda model, table, out, rows, *_: out.__setitem__(rows[1], out[rows[0]]) is None  # noqa: E731
            self._kernel = self._kernel._replace(hold=hold)

        mutant.setattr(work.Trial, "_start", start)
        with pytest.raises(BatteryError, match="computed torque on the true model fails small_step_1, effects"):
            check_controls({0: run_unit(Job(SMALL, unit))})
    assert appraise.PASSES_ALL == "computed_torque"


BAD = """
import os, time
class Good:
    period = 0.028
    def reset(self): self.calls = 0
    def update(self, t, setpoint, measurement):
        self.calls += 1
        if self.calls == 20: self.misbehave()
        return [300.0 * (r - y) for r, y in zip(setpoint, measurement)]
    def misbehave(self): pass
class Hangs(Good):
    def misbehave(self):
        while True:
            try: time.sleep(1)
            except Exception: pass
class Dies(Good):
    def misbehave(self): os._exit(3)
class Killed(Good):
    def misbehave(self): os.kill(os.getpid(), 9)
class Floods(Good):
    def misbehave(self):
        for _ in range(100): print("x" * 100000)
        self.kept = bytearray(1 << 36)
class Nan(Good):
    def update(self, *_): return (float("nan"),) * 3
class Slow(Good):
    def misbehave(self): time.sleep(5.0)
"""


@pytest.fixture
def bad(tmp_path, monkeypatch):
    (tmp_path / "misbehaving.py").write_text(BAD)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))


@pytest.mark.parametrize(
    ("name", "end", "why"),
    [
        ("Hangs", "late", "no answer within"),
        ("Dies", "died", "status 3"),
        ("Killed", "died", "SIGKILL"),
        ("Floods", "refused", "MemoryError"),
        ("Nan", "not_finite", "nan"),
        ("Slow", "late", "no answer within"),
        ("Good", "completed", ""),
    ],
)
def test_a_controller_that_misbehaves_fails_with_the_reason_while_the_rest_goes_on(bad, name, end, why):
    one = replace(SMALL, controllers=(f"misbehaving:{name}",))
    unit = next(unit for unit in one.units if not unit.control)
    answer = 1.0 if end == "late" else 60.0  # the others must not be late on a busy machine
    found = foreign_results(one, unit, Patience(answer, trial=300.0, start=60.0, times=2))
    trials = [each for each in found if each["kind"] == "trial"]
    assert len(trials) == sum(group.draws for group in unit.items)
    assert all(trial["end"] == end and why in trial["why"] for trial in trials)


def test_the_margins_of_an_object_that_is_not_linear_are_injected(bad):
    one = replace(SMALL, controllers=("misbehaving:Good",), tasks=("margins",), perturbations=("nominal",))
    (found,) = foreign_results(one, one.units[-1])
    assert 1.0 < found["measures"]["sensitivity_peak"] < 10.0


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("update(self, t, setpoint, measurement): return 0.0, 0.0", "update gave (0.0, 0.0) at 0.0000 s, not three"),
        ("update(self, t, setpoint, measurement): return setpoint, 0.0, 0.0", "not three numbers"),
        ("update(self, t, setpoint, measurement): return self.gain, 0.0, 0.0", "has no attribute 'gain'"),
        ("update(self, t): return 0.0, 0.0, 0.0", "TypeError"),
        ("update(self, *_): import os; os._exit(4)", "its process ended with status 4"),
    ],
)
def test_a_class_that_cannot_answer_is_refused_before_anything_is_done(method, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "cannot_answer", raising=False)
    (tmp_path / "cannot_answer.py").write_text(f"class C:\n period = 0.028\n def reset(self): 0\n def {method}\n")
    assert main(["appraise", "cannot_answer:C", "--out", "board"]) == 2
    said = capsys.readouterr().err
    assert "controller cannot_answer:C: " in said and message in said
    assert "expected update(t, setpoint, measurement) that answers with three voltages" in said
    assert len(said.splitlines()) == 1 and not (tmp_path / "board").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nobody"], "unknown controller 'nobody'; expected module:Class, or one of those of"),
        (["no_such_module:C"], "ModuleNotFoundError"),
        (["json:JSONDecoder"], "it has no reset()"),
        (["pid", "pid"], "'pid' stands twice"),
        (["pid", "--task", "dance"], "task 'dance'"),
        (["pid", "--perturbation", "rain"], "unknown perturbation 'rain'"),
        (["pid", "--perturbation", "augmented"], "without a model"),
        (["computed_torque_augmented"], "--model FILE with it"),
        (["pid", "--plant", "pendulum"], "a mechanism of kind pendulum with 1 joint"),
        (["pid", "--seed", "-1"], "a whole number, 0 or more"),
        (["pid", "--shard", "3/2"], "i/n with i from 1 to n"),
        (["pid", "--shard", "1/2", "--bags", "3"], "--bags with --shard"),
        (["pid", "--jobs", "2", "--scheduler", "tcp://localhost:1"], "jobs and a scheduler"),
        (["pid", "--bags", "some"], "a whole number, all or none"),
        (["pid", "list"], "'list' among controllers"),
        (["merge"], "no folder"),
        (["merge", "nowhere"], "no run.json"),
        (["merge", "x", "--seed", "1"], "--seed with merge"),
    ],
)
def test_bad_input_names_what_and_what_was_expected(arguments, message, tmp_path, capsys):
    folder = tmp_path / "out"
    assert main(["appraise", *arguments, "--out", str(folder)]) == 2
    assert message in capsys.readouterr().err
    assert not folder.exists()


def test_other_folders_and_models_are_refused(done, tmp_path, capsys):
    other = replace(SMALL, seed=1)
    with open_executor(1) as executor, pytest.raises(RecordingError, match="seed was 0, and is 1 now"):
        run_battery(other, done, executor)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    with open_executor(1) as executor, pytest.raises(RecordingError, match="not empty, and not of such a run"):
        run_battery(SMALL, tmp_path / "full", executor)
    assert os.listdir(tmp_path / "full") == ["thesis.txt"]
    model = tmp_path / "model.yaml"
    model.write_text("format: puma-sim model 1\nmechanism: pendulum\n")
    assert main(["appraise", "pid", "--model", str(model), "--out", str(tmp_path / "m")]) == 2
    assert "--model" in capsys.readouterr().err and not (tmp_path / "m").exists()


def test_arms_of_another_size_or_class_are_refused(tmp_path, capsys):
    drive = torque_drive()
    arm = mechanism(base=drive, shoulder=drive, elbow=drive, zero={"shoulder": LEVEL_DOWN})
    dump_model(arm.plant(), tmp_path / "model.yaml")
    write_yaml(linkage_mapping(arm.body), tmp_path / "arm.yaml", ParameterError)
    own = read_yaml(config_path("mechanisms/puma560.yaml"), ParameterError)
    numbers = read_yaml(config_path("parameters/bejczy.yaml"), ParameterError)
    numbers["geometry"]["a2"]["value"] = 0.2
    write_yaml(numbers, tmp_path / "short.yaml", ParameterError)
    write_yaml({**own, "parameters": "short.yaml"}, tmp_path / "small.yaml", ParameterError)
    out = tmp_path / "out"
    for options, expected in (
        (("--model", str(tmp_path / "model.yaml")), "a model of kind linkage; expected a model of an arm"),
        (
            ("--plant", str(tmp_path / "arm.yaml")),
            "a mechanism of kind linkage with 3 joints; expected one of kind arm",
        ),
        (("--plant", str(tmp_path / "small.yaml")), "expected an arm of the PUMA 560's size"),
    ):
        assert main(["appraise", "pid", *options, "--out", str(out)]) == 2
        assert expected in capsys.readouterr().err and not out.exists()


def test_a_period_that_no_multiple_fits_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd_rate.py").write_text(
        "class C:\n period = 0.003\n def reset(self): 0\n def update(self, *a): return 0, 0, 0\n"
    )
    assert main(["appraise", "odd_rate:C", "--out", "board"]) == 2
    assert (
        "controller odd_rate:C: its period is 0.003 s; expected a whole part of the 0.028 s" in capsys.readouterr().err
    )
    assert not (tmp_path / "board").exists()


def test_a_critical_size_is_where_the_verdict_changes():
    one = replace(SMALL, controllers=("pid",), perturbations=("nominal",), searches=True)
    item = next(each for each in one.searched if each.effect == "encoder_offset:1")
    unit = next(unit for unit in one.units if not unit.control and item in unit.items)
    found = next(r for r in run_unit(Job(one, unit._replace(items=(item,))))["results"])
    # an offset of joint 1 moves the wrist by the angle times its distance from that joint's axis
    task = one.setting.tasks["effects"]
    wrist = wrist_path(task.reference(np.array([stop.until for stop in task.aims.stops])), one.setting.nominal.arm)
    expected = 1e-3 / np.hypot(wrist[:, 0], wrist[:, 1]).max()
    assert found["verdict"] == "found" and 0.98 * found["passed"] < expected < 1.02 * found["failed"]
    assert found["failed"] / found["passed"] < 1.5


def test_a_search_begins_where_machines_are_and_knows_what_no_arm_can_have():
    """A very stiff spring makes a sampled loop chatter: that must not pass for a softness that is critical."""
    one = replace(SMALL, controllers=("pid",), searches=True)
    task, made = one.setting.tasks["effects"], make("pid", one.setting.models)
    good = Trial(task, Conditions(one.setting.nominal), one.setting.nominal.arm, made.period).run(made.controller)
    tried = []

    def attempt(task, conditions, number):
        (spring,) = (each for each in conditions.plant.effects if each.kind.name == "joint_elasticity")
        tried.append(spring.values["stiffness"])
        fine = 3e4 < tried[-1] < 1e6
        return work.Outcome(good, {}) if fine else work.failed_outcome(task, conditions, one, Ended("diverged", ""))

    found = work.search(one, battery.Search("joint_elasticity:2", 0), attempt)
    assert tried[0] == 1e5 and max(tried) == 1e5
    assert found["verdict"] == "found" and found["failed"] < 3e4 < found["passed"] < 1.3 * found["failed"]
    # the links of this draw have less inertia than its motor is said to have of it
    other = work.search(one, battery.Search("joint_elasticity:2", 2), attempt)
    assert other["verdict"] == "impossible" and other["passed"] is other["failed"] is other["size"] is None


def test_listing_names_everything(capsys):
    assert main(["appraise", "list"]) == 0
    text = capsys.readouterr().out
    for name in ("thesis_pid", "poses", "jitter", "coulomb_friction:1..3", "disk_margin", "ISO 9283"):
        assert name in text


def test_what_a_nominal_appraisal_hides_is_paired(tmp_path):
    plant = SMALL.setting.drawing.with_effect("coulomb_friction:2", 1.0, 1.0)
    one = replace(SMALL, model=plant.to_mapping(), perturbations=())
    with open_executor(1) as executor:
        small = replace(one, perturbations=("nominal", "augmented"))
        results = run_battery(small, tmp_path / "models", executor)
        write_report(small, results, str(tmp_path / "models"), 0)
    found = json.loads((tmp_path / "models" / "report.json").read_text())["models"]
    assert found["trials"] == 2 and [row["controller"] for row in found["controllers"]] == list(one.controllers)
    for row in found["controllers"]:
        assert row["score_lost"]["low"] <= row["score_lost"]["value"] <= row["score_lost"]["high"]
        assert all(each["nominal"] != each["augmented"] for each in row["measures"])
        # of one draw the change is its own difference
        for each in row["measures"]:
            assert each["change"]["value"] == pytest.approx(each["augmented"] - each["nominal"], rel=1e-12)
    text = (tmp_path / "models" / "report.html").read_text()
    assert "What the nominal model hides" in text and "change over the draws (95 %)" in text


def test_repetitions_of_iso_9283_are_in_report_and_page(tmp_path):
    one = Battery(("pid",), "standard", tasks=("effects",), perturbations=("noise",), searches=False)
    with open_executor(1) as executor:
        write_report(one, run_battery(one, tmp_path / "board", executor), str(tmp_path / "board"), 0)
    found = json.loads((tmp_path / "board" / "report.json").read_text())
    jsonschema.validate(found, json.loads(config_path("appraisal_report.schema.json").read_text()))
    (row,) = found["repeats"]
    assert (row["controller"], row["task"], row["perturbation"]) == ("pid", "effects", "noise")
    # five draws with noise of 0.02 to 0.2 mrad at a reach of 0.9 m
    assert 1e-6 < row["measures"]["pose_repeatability"] < 1e-3
    assert "pose repeatability" in (tmp_path / "board" / "report.html").read_text()


def test_a_controller_that_was_changed_is_another_battery(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    file = tmp_path / "edited.py"
    file.write_text("class C:\n period = 0.028\n def reset(self): 0\n def update(self, *a): return 0, 0, 0\n")
    one = replace(SMALL, controllers=("edited:C",))
    open_store(tmp_path / "board", one)
    file.write_text(file.read_text().replace("0, 0, 0", "0, 0, 1"))
    with pytest.raises(RecordingError, match="contents of edited:C was"):
        open_store(tmp_path / "board", one)


def test_nothing_to_appraise_or_to_merge_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="no controller"):
        Battery((), "quick")
    with pytest.raises(RecordingError, match="no folder"):
        merge([], tmp_path)


def test_the_time_left_is_that_of_what_was_done_here(monkeypatch):
    now, shown = [0.0], []
    monkeypatch.setattr("puma_sim_core.cli.output.time.monotonic", lambda: now[0])
    progress = TimeLeft(lambda what, share: shown.append(what))
    for now[0], share in ((0.0, 0.5), (10.0, 0.6), (100.0, 0.9)):
        progress("trials", share)
    # half of it stood already: 10 s for a tenth, four tenths to go
    assert shown == ["trials", "trials, about 40 s left", "trials, about 25 s left"]
