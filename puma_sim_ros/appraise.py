# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Appraise controllers that are processes over topics, beside those of `puma-sim appraise`.

  ros2 run puma_sim_ros appraise --ros-args -p out:=board -p controllers:=[mine,pid] \\
      -p mine.command:="ros2 run my_package my_node"
"""

import contextlib
import signal
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rclpy.node import Node

from puma_sim_core.appraisal import controllers
from puma_sim_core.appraisal.appraise import check_controllers, run_battery
from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.controllers import Process
from puma_sim_core.appraisal.report.output import bag_limit, check_report_folder, write_report
from puma_sim_core.appraisal.settings import Patience
from puma_sim_core.appraisal.store import open_store
from puma_sim_core.cli.output import Progress, start_at_once
from puma_sim_core.errors import ModelError, ParameterError, PumaSimError
from puma_sim_core.executors import open_executor
from puma_sim_core.files import read_yaml
from puma_sim_core.simulation.session_config import SessionConfig
from puma_sim_ros.appraisal.command import words_of
from puma_sim_ros.appraisal.topics import Topics
from puma_sim_ros.appraisal.units import Units
from puma_sim_ros.node.parameters import FORMS, of_ros
from puma_sim_ros.startup import ros_started

#: name -> default and meaning; those of `puma-sim appraise` that mean something here
PARAMETERS: dict[str, tuple[Any, str]] = {
    "controllers": ([""], "Names of processes, of baselines, and module:Class."),
    "out": ("", "Folder for results and report; made, or resumed."),
    "profile": ("standard", "How much is tried: quick, standard or full."),
    "seed": (0, "Whole number from which all that is random follows."),
    "plant": ("puma560", "Mechanism whose start is the nominal arm: a name or a file."),
    "model": ("", "Augmented model, such as `explain` writes, to compare with."),
    "tasks": ([""], "Only these tasks."),
    "perturbations": ([""], "Only these perturbations."),
    "searches": (True, "Whether critical sizes are sought."),
    "bags": ("", "Failed trials of each controller that are recorded: a number, all or none; empty: the profile's."),
    "jobs": (0, "Processes for controllers that are not over topics; 0: one for each core."),
    "answer_timeout": (Patience().answer, "Wall-clock time that a process has for one answer [s]."),
    "trial_timeout": (Patience().trial, "Wall-clock time that a process has for all answers of a trial [s]."),
    "start_timeout": (Patience().start, "Wall-clock time that a process has from its start to its first answer [s]."),
}
#: the same for NAME.command and so on, of each controller NAME that is a process
OF_PROCESS: dict[str, tuple[Any, str]] = {
    "command": ("", "What starts it, as in a shell."),
    "interface": ("voltage", "voltage, or position: setpoints of the digital servo."),
    "period": (Process("", "").period, "Time between its commands [s], a whole part of 0.028."),
}
#: time to find nodes that are on the topics already [s]: Fast DDS announces a participant every 3 s where the first
#: announcements are lost
_STRANGERS = 4.0


def values_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters with the given ones in them; ``processes`` of the controllers that are.

    Raises ParameterError: an unknown name, a value of another type, a command whose program is not there.
    """
    names = _texts(given.get("controllers"))
    of = [name for name in dict.fromkeys(names) if name not in controllers.BASELINES and ":" not in name]
    known = PARAMETERS | {f"{name}.{key}": entry for name in of for key, entry in OF_PROCESS.items()}
    unknown = sorted(set(given) - set(known))
    if unknown:
        expected = f"NAME.{', NAME.'.join(OF_PROCESS)} of a process NAME, or one of {', '.join(PARAMETERS)}"
        raise ParameterError("no such parameter", where=f"parameter '{unknown[0]}'", expected=expected)
    values = {name: _checked(name, given.get(name), default) for name, (default, _) in known.items()}
    for name in of:
        if not values[f"{name}.command"]:
            expected = f"a process with parameter '{name}.command', or one of {', '.join(controllers.BASELINES)}"
            raise ParameterError(f"unknown controller '{name}'", where="parameter 'controllers'", expected=expected)
        words_of(values[f"{name}.command"], f"parameter '{name}.command'")
    values["processes"] = tuple(Process(name, *(values[f"{name}.{key}"] for key in OF_PROCESS)) for name in of)
    return values


def _texts(value: Any) -> list[str]:
    # ROS has no empty list of texts: it arrives as a parameter without value
    return [each for each in value or () if each != ""] if isinstance(value, (list, tuple)) else []


def _checked(name: str, value: Any, default: Any) -> Any:
    if isinstance(default, list):
        fits = value is None or (isinstance(value, (list, tuple)) and all(isinstance(each, str) for each in value))
        kind: Any = (list, str)
    else:
        value = default if value is None else value
        fits = type(value) is type(default) or (isinstance(default, float) and type(value) is int)
        kind = type(default)
    if not fits:
        raise ParameterError(repr(value), where=f"parameter '{name}'", expected=FORMS[kind])
    return _texts(value) if isinstance(default, list) else float(value) if kind is float else value


def battery_of(values: Mapping[str, Any]) -> Battery:
    """The battery that parameters describe; raises ParameterError, ModelError."""
    if not values["out"]:
        raise ParameterError("no folder", where="parameter 'out'", expected="the path of one, new or to be resumed")
    if not values["processes"]:
        expected = "one at least that is a process, NAME with NAME.command; `puma-sim appraise` does without"
        raise ParameterError("no process", where="parameter 'controllers'", expected=expected)
    return Battery(
        controllers=tuple(values["controllers"]),
        profile=values["profile"],
        seed=values["seed"],
        mechanism=values["plant"],
        model=read_yaml(values["model"], ModelError) if values["model"] else None,
        tasks=tuple(values["tasks"]),
        perturbations=tuple(values["perturbations"]),
        searches=values["searches"],
        processes=values["processes"],
    )


def run(node: Node) -> list[str]:
    """Appraise what the parameters of a node say; returns the lines to print. Raises the errors of the package."""
    given = {name: each.value for name, each in node.get_parameters_by_prefix("").items() if not of_ros(name)}
    values = values_of(given)
    battery, out = battery_of(values), values["out"]
    timeouts = {name: values[f"{name}_timeout"] for name in ("answer", "trial", "start")}
    for name, value in timeouts.items():
        if not value > 0.0:
            raise ParameterError(repr(value), where=f"parameter '{name}_timeout'", expected="a positive number")
    patience, bags = Patience()._replace(**timeouts), bag_limit(values["bags"] or None, battery)
    check_controllers(battery)
    check_report_folder(out)
    if values["jobs"] < 0:
        raise ParameterError(repr(values["jobs"]), where="parameter 'jobs'", expected="a whole number from 0 on")
    topics = Topics(node, SessionConfig.joint_names, patience)
    with (
        open_executor(values["jobs"] or None) as elsewhere,
        _ending(Units(battery, topics, patience, elsewhere)) as units,
    ):
        start_at_once(patient=True, trials=True).wait()
        if strangers := topics.strangers(_STRANGERS):
            what, expected = (
                f"{', '.join(strangers)} sends commands",
                "another namespace or ROS_DOMAIN_ID, or to end it",
            )
            raise ParameterError(what, where=node.get_namespace(), expected=expected)
        units.check()
        with Progress() as shown:
            units.record(Path(out), bags, open_store(out, battery).results)
            results = run_battery(battery, out, units, progress=shown)
            shown("report", 1.0)
            return write_report(battery, results, out, bags, units.again)


@contextlib.contextmanager
def _ending(units: Units) -> Iterator[Units]:
    """Units whose processes are ended at the end, at once where it is an error."""
    try:
        yield units
    except BaseException:
        units.shutdown(wait=False, cancel_futures=True)
        raise
    units.shutdown()


def main(args: list[str] | None = None) -> int:
    """Entry point of ``appraise``; returns the exit status."""

    def interrupted(number: int, _: object) -> None:
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupted)
    try:
        with ros_started(args):
            # nobody asks for its parameters, and each service would slow down each look at the topics
            node = Node(
                "appraise", automatically_declare_parameters_from_overrides=True, start_parameter_services=False
            )
            print("\n".join(run(node)))
            return 0
    except (PumaSimError, OSError) as error:
        print(f"appraise: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("appraise: interrupted; the same command goes on where it stopped", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
