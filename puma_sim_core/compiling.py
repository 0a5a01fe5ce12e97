# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The kernel compiled by another process, while this one goes on as plain Python.

A program that begins with `Compilation` starts at once from a cold cache. The other process takes the lock of the
cache, so that one compiles however many programs begin; it ends by itself, and lives on where the program ends before.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial

from puma_sim_core import jit

STARTS = "the model runs as plain Python, same numbers, while another process compiles it (once, a minute or two)"
WAITS = "another process compiles the model (once, a minute or two); this command waits for it"
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
        chosen = os.environ.get("PUMA_SIM_KERNEL", "auto") == "auto" and jit.BACKEND == "numba"
        missing = [part for part in parts if chosen and not _is_there(part)]
        if not missing:
            return
        for part in missing:
            jit.await_compiled(part, partial(self._awaited, part))
        self._log = jit.compiled_mark("log")
        with open(str(self._log), "ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "puma_sim_core.identify.compile_ahead", "--behind", *missing],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env={**os.environ, "PUMA_SIM_KERNEL": "numba"},
            )
        if not patient and "arm" in missing:
            say(STARTS)

    def _awaited(self, part: str) -> bool:
        """Whether a part is not ready; one that cannot be compiled never is."""
        if self._patient and not _is_there(part):
            self.wait()
        if not _is_there(part):
            if self._process is not None and self._process.poll() is not None and not _is_there(part):
                self._process = None
                self._say(FAILED.format(self._log))
            return True
        if self._load is None:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=_loaded, args=(self._load,), daemon=True)
            self._thread.start()
        return self._thread.is_alive()

    def wait(self) -> None:
        """Return when the other process has ended, if it was needed."""
        if self._process is not None and self._process.poll() is None:
            self._say(WAITS)
            self._process.wait()


def _is_there(part: str) -> bool:
    mark = jit.compiled_mark(part)
    return mark is None or mark.exists()


def _loaded(load: Callable[[], None]) -> None:
    with jit.compiled_here():
        load()
