# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The process of a controller: started by a command, ended with all that it has started."""

import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

from puma_sim_core.errors import ParameterError
from puma_sim_ros.startup import users_environment

_KEEPER = Path(__file__).with_name("keeper.py")
#: time that a process has to end when it is asked to [s]
_POLITE = 3.0
#: time for its last words after its end [s]: what has left its group, as a daemon does, may hold its output open
_LAST_WORDS = 1.0
#: of what it says, so much is kept [bytes]
_KEPT = 4000


def words_of(command: str, where: str) -> list[str]:
    """The words of a command as a shell splits them.

    Raises ParameterError: no words, quotes that do not end, or a program that is not there.
    """
    expected = "a program with its arguments, such as 'ros2 run my_package my_node'"
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ParameterError(f"'{command}' ({error})", where=where, expected=expected) from None
    if not words:
        raise ParameterError("no command", where=where, expected=expected)
    if shutil.which(words[0]) is None:
        raise ParameterError(f"no program '{words[0]}'", where=where, expected=expected)
    return words


class Running:
    """A command that runs, in a process group of its own; it ends when this process does."""

    def __init__(self, words: list[str]) -> None:
        # the keeper shields nothing else: -I leaves the environment to the command
        self._process = subprocess.Popen(
            [sys.executable, "-I", str(_KEEPER), *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env=users_environment(),
        )
        self._said = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while part := os.read(self._process.stdout.fileno(), 1 << 16):
            self._said = (self._said + part)[-_KEPT:]

    @property
    def last_line(self) -> str:
        """What it said last; all of it is read where it has ended."""
        if self._process.poll() is not None:
            self._reader.join(_LAST_WORDS)
        lines = [line for line in self._said.decode(errors="replace").splitlines() if line.strip()]
        return lines[-1].strip() if lines else ""

    def ended(self) -> str:
        """How it has ended; empty as long as it runs."""
        status = self._process.poll()
        if status is None:
            return ""
        with contextlib.suppress(ValueError):
            if status > 128:
                return f"its process was ended by signal {signal.Signals(status - 128).name}"
        return f"its process ended with status {status}"

    def end(self, polite: bool = True) -> None:
        """End it and all that it has started: asked by SIGINT first, unless it is known not to listen."""
        if polite and self._process.poll() is None:
            self._signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_POLITE)
        self._signal(signal.SIGKILL)
        self._process.wait()
        self._process.stdin.close()
        self._reader.join(_LAST_WORDS)

    def _signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)
