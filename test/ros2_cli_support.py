# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The command line tools of ROS 2 in an environment of their own, with the package installed as colcon installs it.

PUMA_SIM_ROS2CLI names a folder with an `install VENV` of ros2cli and launch. The environment links to the packages of
the one that runs the tests, which stays as it is; it is kept in build/, where a second run finds it.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
VENV = ROOT / "build" / "ros2cli" / PYTHON
PATIENCE = 120.0

_numbers = itertools.count()


def linked_environment(venv: Path) -> None:
    """Make or renew an environment in which everything of the present one is found, the middleware's libraries too."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)
    own = {PYTHON, "site-packages", "ament_index", "resource_index", "packages"}

    def link(source: Path, target: Path) -> None:
        target.mkdir(parents=True, exist_ok=True)
        for path in source.iterdir():
            place = target / path.name
            if place.is_symlink() and not place.exists():
                place.unlink()
            if path.name in own:
                link(path, place)
            elif not place.exists():
                place.symlink_to(path)

    for folder in ("lib", "share"):
        link(Path(sys.prefix) / folder, venv / folder)


class Ros2:
    """`ros2` and what it starts, in a domain of their own; `out` is a folder for what is written."""

    def __init__(self, cli: Path, out: Path) -> None:
        self.out, self.prefix = out, out / "install"
        linked_environment(VENV)
        subprocess.run([cli / "install", VENV], check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.environment = {
            **{k: v for k, v in os.environ.items() if k not in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")},
            "PATH": f"{VENV / 'bin'}:{os.environ['PATH']}",
            "PYTHONPATH": str(self.prefix / "lib" / PYTHON / "site-packages"),
            "AMENT_PREFIX_PATH": f"{self.prefix}:{VENV}",
            "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(out / "log"),
            "PUMA_SIM_KERNEL": "python",
            "PYTHONWARNINGS": "ignore",
            "PYTHONUNBUFFERED": "1",
            "COLUMNS": "200",
        }
        self._install()

    def _install(self) -> None:
        # what colcon does for a package of type ament_python
        base = self.out / "base"
        base.mkdir()
        words = ["egg_info", "--egg-base", base, "build", "--build-base", base / "build", "install"]
        words += ["--prefix", self.prefix, "--record", base / "record", "--single-version-externally-managed"]
        done = self._start([VENV / "bin" / "python", "setup.py", "-q", *words], cwd=ROOT)
        text, _ = done.communicate(timeout=2 * PATIENCE)
        assert done.returncode == 0, text

    def _start(self, words, **how) -> subprocess.Popen:
        # a session of its own, so that one signal reaches all processes, as from a terminal
        return subprocess.Popen(
            [str(word) for word in words],
            env=self.environment,
            text=True,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            **{"cwd": self.out, "stdout": subprocess.PIPE, **how},
        )

    def __call__(self, *words: object, status: int | None = 0) -> str:
        """What `ros2 WORDS` says until it ends; `status` None for any."""
        process = self._start(["ros2", *words])
        try:
            text, _ = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            raise AssertionError(f"ros2 {words} did not end: {process.communicate()[0]}") from None
        assert status in (None, process.returncode), f"ros2 {words} ended with {process.returncode}: {text}"
        return text

    def until(self, pattern: str, *words: object) -> str:
        """What `ros2 WORDS` says until it matches the pattern; it is interrupted then."""
        with self.running(*words) as program:
            return program.wait_for(pattern)

    @contextlib.contextmanager
    def running(self, *words: object, group: bool = True):
        """`ros2 WORDS` beside the test; ended by SIGINT, to all its processes as from a terminal or to it alone."""
        log = self.out / f"{next(_numbers)}.log"
        with log.open("w") as file:
            program = Program(self._start(["ros2", *words], stdout=file), log)
        try:
            yield program
        finally:
            program.interrupt(group)

    def close(self) -> None:
        """End the daemon that the tools have started in this domain."""
        with contextlib.suppress(AssertionError):
            self("daemon", "stop", status=None)


class Program:
    """A program of a session of its own, and what it has said."""

    def __init__(self, process: subprocess.Popen, log: Path) -> None:
        self.process, self.log = process, log

    @property
    def text(self) -> str:
        return self.log.read_text(errors="replace")

    def wait_for(self, pattern: str) -> str:
        """The text once it matches the pattern."""
        end = time.monotonic() + PATIENCE
        while not re.search(pattern, self.text):
            assert self.process.poll() is None, f"it ended with {self.process.returncode}: {self.text}"
            assert time.monotonic() < end, f"no {pattern!r} in {self.text}"
            time.sleep(0.05)
        return self.text

    def wait(self) -> int:
        """The status once it has ended by itself."""
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"it did not end: {self.text}") from None

    def interrupt(self, group: bool) -> None:
        """SIGINT, unless it has ended; SIGKILL for what does not end by that."""
        if self.process.poll() is None:
            (os.killpg if group else os.kill)(self.process.pid, signal.SIGINT)
        try:
            self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            raise AssertionError(f"SIGINT did not end it: {self.text}") from None
