# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The row of the appraisal over topics: a trial with the process of the example, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.task import Row, Unavailable

LABEL = "appraisal, a trial, PID over topics each 28 ms"
_ROOT = Path(__file__).resolve().parents[1]
#: the longest task, and its length [s]
_TASK, _DURATION = "poses", 18.396


class Served:
    """The process that appraises over topics: this module, which runs a trial for each line of standard input."""

    def __init__(self) -> None:
        if find_spec("rclpy") is None:
            raise Unavailable("rclpy is not installed")
        path = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
        # nothing here may reach a robot on the network
        variables = {"PYTHONPATH": path, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": "97"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.topics"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={"AMENT_PREFIX_PATH": sys.prefix, **os.environ, **variables},
        )

    def measure(self) -> tuple[float, np.ndarray]:
        """(seconds, final positions) of one trial."""
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise Unavailable(f"its process ended with status {self._process.wait()}")
        elapsed, position = json.loads(answer)
        return elapsed, np.array(position)

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


@contextmanager
def rows() -> Iterator[list[Row]]:
    """The row, as long as its process is there; raises Unavailable."""
    served = Served()
    try:
        note = f"{_DURATION:.1f} s of '{_TASK}'; elapsed time of two processes, Python on both sides"
        run = lambda: served.measure()[1]  # noqa: E731
        yield [Row(LABEL, run, _DURATION, ours=True, compared=False, note=note, measure=served.measure)]
    finally:
        served.close()


def serve() -> None:
    """Answer each line with ``[elapsed seconds, [q1, q2, q3]]``."""
    import rclpy
    from rclpy.node import Node

    from puma_sim_core.appraisal.battery import Battery
    from puma_sim_core.appraisal.controllers import Process, make
    from puma_sim_core.appraisal.settings import Patience
    from puma_sim_core.appraisal.trials.trial import Trial
    from puma_sim_ros.appraisal.foreign import Foreign
    from puma_sim_ros.appraisal.topics import Topics

    setting = Battery(("pid",), "quick").setting
    task, conditions = setting.tasks[_TASK], setting.drawing.conditions("nominal", 0, 0.0)
    assert abs(task.duration - _DURATION) < 1e-9
    rclpy.init(args=[])
    topics = Topics(Node("appraise", start_parameter_services=False), ("joint1", "joint2", "joint3"), Patience())
    process = Process("example", f"{sys.executable} {_ROOT / 'examples' / 'appraised.py'} voltage")
    foreign = Foreign(process, topics, lambda: make("pid", setting.models).controller)
    try:
        # whatever has to be compiled or loaded
        foreign.run(Trial(task, conditions, setting.nominal.arm, foreign.period))
        for _ in sys.stdin:
            start = perf_counter()
            response = foreign.run(Trial(task, conditions, setting.nominal.arm, foreign.period))
            elapsed = perf_counter() - start
            assert not response.failed, response.why
            print(json.dumps([elapsed, response.position[-1].tolist()]), flush=True)
    finally:
        foreign.stop()
        rclpy.try_shutdown()


if __name__ == "__main__":
    serve()
