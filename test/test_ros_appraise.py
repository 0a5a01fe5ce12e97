# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`ros2 run puma_sim_ros appraise`: processes over topics with the bits of the core, and those that misbehave."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import jsonschema
import numpy as np
import pytest

pytest.importorskip("rclpy")

from misbehaving_process import WAYS
from ros_support import PATIENCE, Peer, arguments, environment
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from puma_sim_core.appraisal.battery import Battery, Group
from puma_sim_core.appraisal.controllers import make
from puma_sim_core.appraisal.margins.linearisation import linear_margins
from puma_sim_core.appraisal.margins.margins import margin_measures
from puma_sim_core.appraisal.measures import measure
from puma_sim_core.appraisal.settings import Patience
from puma_sim_core.appraisal.trials.trial import Trial
from puma_sim_core.appraisal.work import conditions_of
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.errors import PumaSimError
from puma_sim_core.recording.bag import read_bag
from puma_sim_core.resources import config_path
from puma_sim_core.simulation.replay import replay
from puma_sim_ros.appraisal.command import Running
from puma_sim_ros.appraisal.topics import Topics
from puma_sim_ros.appraise import battery_of, values_of

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "examples" / "appraised.py"
BOARD = {
    "controllers": "[volts, same, example, pid]",
    "volts.command": f"{sys.executable} {EXAMPLE} voltage",
    "same.command": f"{sys.executable} {EXAMPLE} position 0",
    "same.interface": "position",
    "example.command": f"{sys.executable} -m puma_sim_ros.appraised_controller"
    " --ros-args -p controller:=computed_torque",
    "profile": "quick",
    "tasks": "[small_step_1, simultaneous_steps]",
    "perturbations": "[nominal, noise, jitter]",
    "searches": "false",
    # a busy machine fails nobody
    "answer_timeout": 60.0,
}
ONE = {
    "controllers": "[mine]",
    "mine.command": f"{sys.executable} {EXAMPLE} voltage",
    "profile": "quick",
    "tasks": "[small_step_1]",
    "perturbations": "[nominal]",
    "searches": "false",
    # a busy machine fails nobody
    "answer_timeout": 60.0,
}


def example_law():
    """The controller of the example, as the class that it is."""
    spec = importlib.util.spec_from_file_location("appraised", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Pid()


def start(out: Path, number: int = 0, **parameters) -> subprocess.Popen:
    """The program, in a namespace of its own and with the model as plain Python."""
    there = f"-r __ns:=/appraise{os.getpid()}_{number}"
    commands = {
        name: f"{text} {'' if '--ros-args' in text else '--ros-args '}{there}"
        for name, text in parameters.items()
        if name.endswith(".command")
    }
    words = [*arguments({"out": out, **parameters, **commands}), *there.split()]
    return subprocess.Popen(
        [sys.executable, "-m", "puma_sim_ros.appraise", *words],
        env=environment(),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def ended(process: subprocess.Popen, status: int = 0) -> str:
    """What it has said, once it has ended by itself."""
    output, errors = process.communicate(timeout=8 * PATIENCE)
    assert process.returncode == status, errors
    return output if status == 0 else errors


def trials_of(report, controller):
    return {
        (each["task"], each["perturbation"]): each
        for unit in report
        if unit["controller"] == controller and not unit["control"]
        for each in unit["results"]
    }


def results(out: Path):
    """Results of all units."""
    return [json.loads(path.read_text()) for path in sorted(out.glob("units/*/result.json"))]


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """The folder of a battery of three processes, killed on its way and gone on with."""
    out = tmp_path_factory.mktemp("appraise") / "board"
    first = start(out, **BOARD)
    deadline = time.monotonic() + 8 * PATIENCE
    while not any(unit["controller"] == "volts" for unit in results(out)):
        assert first.poll() is None and time.monotonic() < deadline, first.communicate()
        time.sleep(0.02)
    first.kill()
    first.wait()
    before = {path: path.stat().st_mtime_ns for path in out.glob("units/*/result.json")}
    ended(start(out, **BOARD))
    # what stood was not done again
    assert before and all(path.stat().st_mtime_ns == at for path, at in before.items())
    return out


def core_controllers():
    setting = Battery(("pid",), "quick").setting
    torque = make_controller(
        "computed_torque",
        load_parameters("bejczy"),
        load_settings("computed_torque", "external"),
        0.028,
        setpoint_period=0.028,
    )
    return setting, {"volts": example_law(), "same": make("pid", setting.models).controller, "example": torque}


@pytest.mark.long
def test_trials_over_topics_are_those_of_the_core_to_the_last_bit(board):
    battery = Battery(("pid",), "quick")
    setting, own = core_controllers()
    found = results(board)
    compared = 0
    for name, controller in own.items():
        for (task, perturbation), trial in trials_of(found, name).items():
            conditions = conditions_of(battery, Group(task, perturbation, 1), 0)
            inside = Trial(setting.tasks[task], conditions, setting.nominal.arm, controller.period)
            response = inside.run(controller)
            measures = {key: value for key, value in trial["measures"].items() if value is not None}
            expected = measure(response, setting.tasks[task].aims)
            assert measures and {key: expected[key] for key in measures} == measures
            assert response.end == trial["end"] == "completed"
            compared += 1
            bag = board / "bags" / f"{name}_{task}_{perturbation}_0"
            if bag.exists():
                assert np.array_equal(read_bag(bag).position, response.position)
    assert compared == 12
    same, pid = trials_of(found, "same"), trials_of(found, "pid")
    # where the kernel runs the servo, sums over the same voltages are taken in another order
    for place, each in same.items():
        assert each["measures"] == pytest.approx(pid[place]["measures"], rel=1e-12)


@pytest.mark.long
def test_a_killed_appraisal_has_each_trial_once_and_its_bags_replay(board):
    report = json.loads((board / "report.json").read_text())
    jsonschema.validate(report, json.loads(config_path("appraisal_report.schema.json").read_text()))
    assert [each["trials"] for each in report["scoreboard"]] == [4, 4, 4, 4]
    numbers = [unit["unit"] for unit in results(board)]
    assert numbers == list(range(len(numbers)))
    bags = [each["bag"] for each in report["failures"] if each["controller"] != "pid"]
    assert bags and all(bags) and all(replay(board / bag).identical for bag in bags)


@pytest.mark.long
def test_margins_over_topics_are_those_of_the_linearisation(tmp_path):
    ended(start(tmp_path / "board", 1, **ONE | {"tasks": "[margins]"}))
    (trial,) = trials_of(results(tmp_path / "board"), "mine").values()
    setting, own = core_controllers()
    exact = margin_measures(list(linear_margins(setting.nominal, setting.tasks["margins"].start, own["volts"])))
    assert {name: trial["measures"][name] for name in exact} == pytest.approx(exact, rel=0.05)
    assert trial["passed"]


@pytest.mark.long
def test_a_process_that_misbehaves_fails_with_the_reason_and_the_rest_goes_on(tmp_path):
    wanted = {
        "tasks": "[small_step_1, small_step_2, small_step_3, "
        "large_step_1, large_step_2, large_step_3, simultaneous_steps]",
        "perturbations": "[nominal, noise]",
        "mine.command": f"{sys.executable} {ROOT / 'test' / 'misbehaving_process.py'} {tmp_path / 'count'}",
        "bags": "all",
        # a busy machine must not make those late that do not hang
        "answer_timeout": PATIENCE / 4,
        "trial_timeout": 4 * PATIENCE,
        "start_timeout": 4 * PATIENCE,
    }
    out = tmp_path / "board"
    ended(start(out, 2, **ONE | wanted))
    found = list(trials_of(results(out), "mine").values())
    expected = {
        "well": ("completed", ""),
        "hangs": ("late", f"no answer within {PATIENCE / 4:g} s, at 0.2520 s"),
        "dies": ("died", "its process was ended by signal SIGSEGV, at 0.2520 s"),
        "not finite": ("not_finite", "voltages (nan, 0, 0) at 0.2520 s"),
        "floods": ("refused", "it sent more commands than it got states"),
        "two numbers": ("refused", "update gave (0.0, 0.0) at 0.2520 s, not three numbers"),
    }
    assert len(found) == len(WAYS)
    for each, (end, why) in zip(found, map(expected.get, WAYS)):
        assert each["end"] == end and each["why"].startswith(why)
    bags = list((out / "bags").iterdir())
    assert len(bags) == sum(not each["passed"] for each in found)
    assert all(replay(bag).identical for bag in bags)


def test_parameters_that_cannot_be_are_named():
    good = {"controllers": ["mine", "pid"], "mine.command": "true", "out": "board"}
    battery = battery_of(values_of(good))
    assert [tuple(process) for process in battery.processes] == [("mine", "true", "voltage", 0.028)]
    for changes, message in (
        ({"colour": "red"}, "parameter 'colour': no such parameter"),
        ({"mine.gain": 1.0}, "parameter 'mine.gain': no such parameter"),
        ({"seed": "one"}, "parameter 'seed': 'one'; expected an integer"),
        ({"tasks": [1.0]}, "parameter 'tasks'"),
        ({"out": ""}, "parameter 'out': no folder"),
        ({"mine.interface": "torque"}, "torque"),
        ({"mine.period": 0.003}, "whole part of the 0.028 s"),
        ({"mine.period": -1.0}, "its period is -1.0"),
        ({"mine.interface": "position", "mine.period": 0.014}, "expected 0.028 s, that of the servo's setpoints"),
        ({"controllers": ["pid"], "mine.command": None}, "parameter 'mine.command': no such parameter"),
        ({"mine.command": "no-such-program -v"}, "parameter 'mine.command': no program 'no-such-program'"),
        ({"mine.command": "'true"}, "No closing quotation"),
        ({"profile": "fast"}, "fast"),
        ({"tasks": ["fly"]}, "fly"),
        ({"controllers": ["mine", "mine"]}, "stands twice"),
        ({"controllers": ["mine", "2fast"], "2fast.command": "true"}, "the name '2fast'"),
        ({"controllers": ["mine", "pod"]}, "unknown controller 'pod'; expected a process with parameter 'pod.command'"),
    ):
        with pytest.raises(PumaSimError) as refused:
            battery_of(values_of(good | changes))
        assert message in str(refused.value)


def test_a_process_that_does_not_start_leaves_nothing_behind(tmp_path):
    program = tmp_path / "ends.py"
    program.write_text("import sys; sys.exit('no gains')")
    wanted = ONE | {"mine.command": f"{sys.executable} {program}"}
    errors = ended(start(tmp_path / "board", 3, **wanted), 2)
    assert "appraise: parameter 'mine.command': its process ended with status 1 before its first answer" in errors
    assert "and said last: no gains; expected a process that answers" in errors
    assert not (tmp_path / "board").exists()


def test_the_last_words_of_a_process_are_not_missed():
    for _ in range(10):
        process = Running([sys.executable, "-c", "import sys; sys.exit('no gains')"])
        while not process.ended():
            pass
        assert process.last_line == "no gains"
        process.end()


def test_somebody_else_who_sends_commands_is_named(tmp_path):
    with Peer(f"/appraise{os.getpid()}_4", name="somebody"):
        errors = ended(start(tmp_path / "board", 4, **ONE), 2)
    assert "somebody sends commands; expected another namespace" in errors
    assert not (tmp_path / "board").exists()


class Counting:
    """A controller in another participant, in a thread: it answers each state with how many it has had since `reset`,
    a service that is seen only some seconds `after` the first answer, as on a busy machine."""

    def __init__(self, namespace: str, after: float = 0.5) -> None:
        self.peer = Peer(namespace, name="counting")
        self.peer.on_state = self.answer
        self.states, self.service, self.made_at, self.after = 0, None, float("inf"), after
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.spin)

    def spin(self) -> None:
        while not self.stop.is_set():
            self.peer.executor.spin_once(timeout_sec=0.02)
            if self.service is None and time.monotonic() > self.made_at:
                self.service = self.peer.node.create_service(Trigger, "~/reset", self.reset)

    def answer(self, _state) -> None:
        self.states += 1
        self.made_at = min(self.made_at, time.monotonic() + self.after)
        self.peer.commands.publish(Float64MultiArray(data=[float(self.states)] * 3))

    def reset(self, _request, response):
        self.states, response.success = 0, True
        return response

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_exception) -> None:
        self.stop.set()
        self.thread.join()
        self.peer.close()


@contextmanager
def met(number: int, **service):
    """Topics that have met `Counting`, itself, and a trial over them: what it answers to two states."""
    namespace, reference = f"/appraise{os.getpid()}_{number}", np.zeros((1, 3))
    with Counting(namespace, **service) as counting, Peer(namespace, interface=None, name="appraisal") as own:
        own.executor.remove_node(own.node)
        topics = Topics(own.node, ["joint1", "joint2", "joint3"], Patience(answer=PATIENCE, start=PATIENCE))
        topics.listen("voltage")
        topics.connect(reference, str)

        def trial():
            topics.begin(reference)
            return [topics.ask(0.0, reference[0], reference[0])[0] for _ in range(2)]

        yield topics, counting, trial


def test_a_service_that_is_seen_late_resets_all_the_same():
    with met(5) as (topics, _, trial):
        assert [trial(), trial()] == [[1.0, 2.0], [1.0, 2.0]]
        assert topics.objection() == ""


def test_a_trial_before_which_a_service_was_not_seen_does_not_count(monkeypatch):
    monkeypatch.setattr("puma_sim_ros.appraisal.topics._RESET", 0.2)
    with met(6, after=float("inf")) as (topics, counting, trial):
        assert trial() != [1.0, 2.0]
        counting.made_at, deadline = 0.0, time.monotonic() + PATIENCE
        while not (why := topics.objection()):
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert "~/reset showed itself only after the trial had begun" in why
        assert trial() == [1.0, 2.0]
        assert topics.objection() == ""
