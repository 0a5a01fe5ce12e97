# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The kernel compiled by another process, while this one goes on as plain Python.

A program that begins with `Compilation` starts at once from a cold cache. Who starts the other process takes the lock
of the cache and hands it over, so that one is there however many programs begin. It ends by itself, and lives on where
the program ends before; one that takes what others leave gives way to a program that has nothing to do but wait.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import IO

from puma_sim_core import jit

_LONG = "once, a minute or two of a free core"
STARTS = f"the model runs as plain Python, same numbers, while another process compiles it ({_LONG})"
WAITS = f"another process compiles the model ({_LONG}); this command waits for it"
#: niceness of work that may take what others leave
_LOW = 10
FAILED = "the model could not be compiled and goes on as plain Python; see {}"


def lacks_numba() -> bool:
    """Whether plain Python was not chosen, but is all that there is."""
    return jit.BACKEND == "python" and os.environ.get("PUMA_SIM_KERNEL", "auto") == "auto"


class Compilation:
    """Parts of the kernel that are not in the cache, on their way.

    parts : which, `jit.PARTS` by default.
    say : takes what a person should know; load : what to run in a thread of its own once the parts are there, so that a
    first use need not load them; patient : a first run waits for all parts, for work that takes longer without.

    Where nothing is to be compiled, or ``PUMA_SIM_KERNEL`` is ``numba``, or there is no cache, this does nothing: a
    first use then loads or compiles in this process.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        load: Callable[[], None] | None = None,
        patient: bool = False,
        parts: Sequence[str] = jit.PARTS,
    ):
        self._say, self._load, self._patient = say, load, patient
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None
        self._failed = False
        #: threads of a program ask at the same time
        self._turn = threading.Lock()
        chosen = os.environ.get("PUMA_SIM_KERNEL", "auto") == "auto" and jit.BACKEND == "numba"
        self._missing = missing = [part for part in parts if chosen and not _is_there(part)]
        if not missing:
            return
        for part in missing:
            jit.await_compiled(part, partial(self._awaited, part))
        self._log = jit.compiled_mark("log")
        self._begin()
        if not patient and "arm" in missing:
            say(STARTS)

    def _begin(self, waits: bool = False) -> None:
        """Start the other process where what is missing is still missing.

        waits : wait for whoever begins or is at work, and end what is behind; otherwise do nothing then.
        """
        with _opened("lock") as lock, contextlib.suppress(BlockingIOError):
            lock_in_turn(lock, waits)
            if not all(map(_is_there, self._missing)):
                self._start(lock)

    def _start(self, lock: IO[str]) -> None:
        """Start the other process, which holds the lock until it ends."""
        with open(str(self._log), "ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "puma_sim_core.identify.compile_ahead", "--locked", *self._missing],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env={**os.environ, "PUMA_SIM_KERNEL": "numba"},
                pass_fds=(lock.fileno(),),
            )
        behind = _behind()
        if self._patient:
            # this program has nothing to do but wait
            behind.unlink(missing_ok=True)
        else:
            _put_behind(self._process.pid)
            behind.write_text(str(self._process.pid))

    def _awaited(self, part: str) -> bool:
        """Whether a part is not ready; one that cannot be compiled never is."""
        with self._turn:
            if self._patient and not _is_there(part):
                self.wait()
            if not _is_there(part):
                self._look()
                return True
            if self._load is None:
                return False
            if self._thread is None:
                self._thread = threading.Thread(target=_loaded, args=(self._load,), daemon=True)
                self._thread.start()
            return self._thread.is_alive()

    def _look(self) -> None:
        """See that somebody is at work on what is missing, or say that it has failed."""
        if self._failed or (self._process is not None and self._process.poll() is None):
            return
        if all(map(_is_there, self._missing)):
            return
        if self._process is None or self._process.returncode == -signal.SIGTERM:
            # another program's process, which may have made other parts, or to which this one's gave way
            self._process = None
            self._begin()
            return
        self._failed = True
        self._say(FAILED.format(self._log))

    def wait(self) -> None:
        """Return when what is missing is there, or cannot be compiled."""
        self._patient = True
        said = False
        while not self._failed and not all(map(_is_there, self._missing)):
            if not said:
                self._say(WAITS)
                said = True
            if self._process is not None:
                self._process.wait()
            else:
                self._begin(waits=True)
            self._look()


def lock_in_turn(lock: IO[str], waits: bool) -> None:
    """Take the lock of the cache, an open file.

    waits : wait for whoever has it, and end what is behind others; otherwise raise BlockingIOError where it is taken.
    """
    now = 0 if waits else fcntl.LOCK_NB
    # in the turn of one program alone, so that none takes the place of one that gave way
    with _opened("turn") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX | now)
        if waits:
            _end_what_is_behind()
        fcntl.flock(lock, fcntl.LOCK_EX | now)


def _opened(name: str) -> IO[str]:
    return open(str(jit.compiled_mark(name)), "a")


def _put_behind(process: int) -> None:
    """Let a process take what others leave: at once, since what it imports before its first line takes seconds."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process, _LOW)
        # Linux may share the processors out by sessions first, and that process has one of its own
        Path(f"/proc/{process}/autogroup").write_text(str(_LOW))


def _behind() -> Path:
    """The file with the number of the last process that was put behind others."""
    return Path(str(jit.compiled_mark("behind")))


def _end_what_is_behind() -> None:
    """End a process that others may keep from its work for long; what it has made is in the cache."""
    with contextlib.suppress(OSError, ValueError):
        process = int(_behind().read_text())
        if os.getpriority(os.PRIO_PROCESS, process) == _LOW:
            os.kill(process, signal.SIGTERM)


def _is_there(part: str) -> bool:
    mark = jit.compiled_mark(part)
    return mark is None or mark.exists()


def _loaded(load: Callable[[], None]) -> None:
    with jit.compiled_here():
        load()
