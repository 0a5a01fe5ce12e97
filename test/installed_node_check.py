# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Check of a colcon build: the installed node in lockstep with the installed controller.

Run it in a shell that has sourced the workspace's ``install/setup.bash``. It takes the programs
from where ``ros2 run`` would take them, lets the controller drive the node over DDS until it has
done its path, stops the node with SIGINT, and has the installed ``puma-sim replay`` compare the
bag with the core. It ends with status 0 when all of that held, else with a line that says what
did not.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_prefix

PACKAGE = "puma_sim_ros"
#: fewer states than this and the controller cannot have driven a path
FEWEST_STATES = 50


def fail(message: str, *logs: Path) -> None:
    for log in logs:
        if log.exists():
            print(f"--- {log.name}\n{log.read_text(errors='replace')[-3000:]}", file=sys.stderr)
    sys.exit(f"installed node: {message}")


def check_files(prefix: Path, out: Path) -> None:
    """The programs, the modules and the configuration are those of the workspace."""
    for program in ("sim_node", "external_controller", "puma-sim"):
        path = prefix / "lib" / PACKAGE / program
        if not os.access(path, os.X_OK):
            fail(f"{path} is not there or not executable")
    for name in ("package.xml", "config/parameters/bejczy.yaml"):
        if not (prefix / "share" / PACKAGE / name).exists():
            fail(f"share/{PACKAGE}/{name} is not in {prefix}")
    # a linked build leads to the checkout through the workspace's build folder
    workspace = prefix.parent.parent
    code = (
        "import puma_sim_core, puma_sim_ros; from puma_sim_core.resources import config_path;"
        "config_path('parameters', 'bejczy.yaml');"
        "print(puma_sim_core.__file__); print(puma_sim_ros.__file__)"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=out, check=True, text=True, stdout=subprocess.PIPE
    ).stdout.split("\n")
    for module in filter(None, found):
        if not Path(module).is_relative_to(workspace):
            fail(f"{module} is imported, which is not of the workspace {workspace}")


def drive(programs: Path, out: Path, seconds: float) -> Path:
    """Node and controller as two processes; returns the bag."""
    bag = out / "bag"
    logs = out / "sim_node.log", out / "external_controller.log"
    with open(logs[0], "w") as node_log, open(logs[1], "w") as controller_log:
        node = subprocess.Popen(
            [
                programs / "sim_node",
                "--ros-args",
                "-p",
                "mode:=lockstep",
                "-p",
                "command_interface:=voltage",
                "-p",
                f"bag_path:={bag}",
            ],
            stdout=node_log,
            stderr=subprocess.STDOUT,
            cwd=out,
        )
        controller = subprocess.Popen(
            [programs / "external_controller", "--ros-args", "-p", f"timeout:={seconds:.1f}"],
            stdout=controller_log,
            stderr=subprocess.STDOUT,
            cwd=out,
        )
        try:
            deadline = time.monotonic() + seconds
            while controller.poll() is None and node.poll() is None:
                if time.monotonic() > deadline:
                    fail(f"the controller had not done its path after {seconds:g} s", *logs)
                time.sleep(0.05)
            if node.poll() is not None:
                fail(f"the node ended by itself, status {node.returncode}", *logs)
            if controller.returncode != 0:
                fail(f"the controller ended with status {controller.returncode}", *logs)
            node.send_signal(signal.SIGINT)
            try:
                node.wait(timeout=seconds)
            except subprocess.TimeoutExpired:
                fail(f"the node did not end within {seconds:g} s of SIGINT", *logs)
            if node.returncode != 0:
                fail(f"the node ended with status {node.returncode} on SIGINT", *logs)
        finally:
            for process in (controller, node):
                if process.poll() is None:
                    process.kill()
                    process.wait()
    return bag


def check_bag(programs: Path, bag: Path) -> str:
    metadata = bag / "metadata.yaml"
    if not metadata.exists():
        fail(f"{metadata} was not written")
    information = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]
    counts = {
        topic["topic_metadata"]["name"]: topic["message_count"] for topic in information["topics_with_message_count"]
    }
    states = max((n for name, n in counts.items() if name.endswith("joint_states")), default=0)
    if states < FEWEST_STATES:
        fail(f"the bag holds {states} joint states, expected {FEWEST_STATES} or more: {counts}")
    replay = subprocess.run(
        [programs / "puma-sim", "replay", bag], text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    if replay.returncode != 0 or "identical" not in replay.stdout:
        fail(f"replay ended with status {replay.returncode}: {replay.stdout}")
    return f"{states} states; {replay.stdout.strip().splitlines()[-1]}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="a new folder for logs and the bag")
    parser.add_argument("--seconds", type=float, default=300.0, help="how long the path may take")
    arguments = parser.parse_args()
    out = arguments.out.resolve()
    out.mkdir(parents=True)
    # away from other nodes of this machine, and off its network
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    # the interpreted kernel starts at once: no time limit here may count a compilation
    os.environ["PUMA_SIM_KERNEL"] = "python"
    prefix = Path(get_package_prefix(PACKAGE))
    programs = prefix / "lib" / PACKAGE
    check_files(prefix, out)
    bag = drive(programs, out, arguments.seconds)
    print(f"installed node: ok, {check_bag(programs, bag)}")


if __name__ == "__main__":
    main()
