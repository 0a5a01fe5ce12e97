# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`sim_node` and a controller as two processes over DDS, from the start to the closed bag.

A controller is a module of puma_sim_ros or a file of this folder.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from puma_sim_core.errors import PumaSimError
from puma_sim_core.resources import config_path

#: longest time for a session [s]. Nothing of it waits for the compiler; it is long for machines that do other work.
PATIENCE = 300.0
#: programs with a file of parameters in config/
_WITH_FILE = ("sim_node", "external_controller")


class ProgramError(PumaSimError):
    """One of the programs failed."""


def environment(**more: str) -> dict[str, str]:
    """That of the children: a domain of their own unless the user has one, this machine only."""
    result = {**os.environ, **more}
    result.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    result["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    # a checkout that is not installed serves as well
    root = str(Path(__file__).resolve().parents[2])
    result["PYTHONPATH"] = os.pathsep.join(filter(None, (root, result.get("PYTHONPATH"))))
    return result


def start(module: str, parameters: dict[str, object], log: Path, **variables: str) -> subprocess.Popen:
    """A module of puma_sim_ros, or a file of this folder, with ROS parameters over those of its file in config/.

    variables : of its environment, beside those of `environment`.
    """
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    if module in _WITH_FILE:
        words = ["--params-file", str(config_path(f"{module}.yaml")), *words]
    script = Path(__file__).with_name(f"{module}.py")
    program = [str(script)] if script.exists() else ["-m", f"puma_sim_ros.{module}"]
    with open(log, "w", encoding="utf-8") as output:
        return subprocess.Popen(
            [sys.executable, *program, "--ros-args", *words],
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment(**variables),
        )


def run_session(
    out: Path,
    node_parameters: dict[str, object],
    controller: str,
    controller_parameters: dict[str, object],
    patience: float = PATIENCE,
    **variables: str,
) -> tuple[Path, str]:
    """Run `sim_node` until a controller has done its work.

    Parameters
    ----------
    out : folder for the bag (``bag``, or with a number where there is one already) and the logs.
    controller : a module or file, see above, that ends when it is done.
    patience : longest time for it [s]; variables : of both programs' environment.

    Returns
    -------
    The bag's path and the node's last line.

    Raises
    ------
    ProgramError : one of them failed, or did not end in time.
    """
    bag, number = out / "bag", 1
    while bag.exists():
        bag, number = out / f"bag_{number}", number + 1
    logs = {name: out / f"{name}.log" for name in ("sim_node", controller)}
    node = start("sim_node", {**node_parameters, "bag_path": bag}, logs["sim_node"], **variables)
    other = None
    try:
        other = start(controller, controller_parameters, logs[controller], **variables)
        end = time.monotonic() + patience
        while other.poll() is None and time.monotonic() < end:
            _check(node.poll() is None, f"sim_node ended by itself, status {node.poll()}", logs["sim_node"])
            time.sleep(0.05)
        _check(other.poll() is not None, f"{controller} had not done its motion after {patience:g} s", *logs.values())
        _check(other.poll() == 0, f"{controller} ended with status {other.poll()}", logs[controller])
        node.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            node.wait(timeout=patience)
        _check(node.poll() is not None, f"sim_node had not ended {patience:g} s after SIGINT", logs["sim_node"])
        _check(node.poll() == 0, f"sim_node ended with status {node.poll()}", logs["sim_node"])
    finally:
        for process in (other, node):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
    return bag, logs["sim_node"].read_text(encoding="utf-8").splitlines()[-1]


def _check(condition: bool, what: str, *logs: Path) -> None:
    if not condition:
        tails = [f"the end of {log.name} is\n{_tail(log)}" for log in logs]
        raise ProgramError("; ".join([what, *tails]), where=logs[0].parent)


def _tail(log: Path) -> str:
    return "\n".join(log.read_text(encoding="utf-8").splitlines()[-8:]) or "(empty)"


def as_program(name: str, work: Callable[[], None]) -> int:
    """Do the work of a demonstration; errors go to standard error. Returns the exit status."""
    if importlib.util.find_spec("rclpy") is None:
        print(
            f"{name}: rclpy is not installed; on a machine without ROS 2:\n"
            "  pip install 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces",
            file=sys.stderr,
        )
        return 2
    try:
        work()
    except (PumaSimError, OSError, subprocess.TimeoutExpired) as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0
