# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Where the output of a command goes, and the line that shows how far it is."""

from __future__ import annotations

import argparse
import difflib
import logging
import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

from puma_sim_core.errors import PumaSimError, RecordingError
from puma_sim_core.files import is_special, whole_file

if TYPE_CHECKING:
    from puma_sim_core.compiling import Compilation


#: what is said to a person beside the result: notes and sums (INFO), warnings, and with --verbose more (DEBUG)
LOG = logging.getLogger("puma_sim")


@contextmanager
def reporting(quiet: bool = False, verbose: bool = False) -> Iterator[None]:
    """Show on standard error what is said to `LOG`: with `quiet` warnings alone, with `verbose` everything."""
    handler = logging.StreamHandler()
    before, LOG.propagate = (LOG.level, LOG.propagate), False
    LOG.setLevel(logging.WARNING if quiet else logging.DEBUG if verbose else logging.INFO)
    LOG.addHandler(handler)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.level, LOG.propagate = before


def add_force_argument(parser: argparse.ArgumentParser) -> None:
    """Declare --force, for `check_output` and folders of results."""
    parser.add_argument("--force", action="store_true", help="replace files that are there already")


def check_input(path: str) -> None:
    """Refuse, before anything slow is loaded, a file that is not there.

    Raises RecordingError: names the path, and a file beside it whose name is near.
    """
    if os.path.exists(path):
        return
    folder, name = os.path.split(path)
    try:
        near = difflib.get_close_matches(name, os.listdir(folder or "."), n=1)
    except OSError:
        near = []
    expected = f"a file; {os.path.join(folder, near[0])} is near" if near else "a file that is there"
    raise RecordingError("cannot be read (No such file or directory)", where=path, expected=expected)


def check_output(path: str, inputs: Iterable[str] = (), *, force: bool = False) -> None:
    """Refuse, before the work, a path that cannot be written, that is one of the inputs, or that is there already
    unless `force`.

    Raises RecordingError: names the path.
    """
    if path == "-" or is_special(path):
        return
    folder = os.path.dirname(os.path.realpath(path))
    for problem, is_so in (
        ("is a folder", os.path.isdir(path)),
        ("its folder does not exist", not os.path.isdir(folder)),
        ("its folder cannot be written", not os.access(folder, os.W_OK)),
        ("cannot be written", os.path.exists(path) and not os.access(path, os.W_OK)),
    ):
        if is_so:
            raise RecordingError(problem, where=path, expected="a file in a folder that can be written, or -")
    for other in inputs:
        if os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other):
            raise RecordingError("is an input of this command", where=path, expected="another file to write")
    if os.path.exists(path) and not force:
        raise RecordingError("is there already", where=path, expected="another name, or --force to replace it")


@contextmanager
def output_file(path: str, error: type[PumaSimError] = RecordingError) -> Iterator[TextIO]:
    """A text file to write: standard output for ``-``, else a file that appears as a whole.

    Raises error: the file cannot be written; names it.
    """
    if path != "-":
        with whole_file(path, error) as file:
            yield file
        return
    try:
        yield sys.stdout
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as reason:
        what, expected = f"cannot be written ({reason.strerror})", "a place that takes the output"
        raise error(what, where="standard output", expected=expected) from None


#: seconds after which what was last begun is looked at again
_TICK = 1.0


class Progress:
    """What a command does and how far it is, on standard error; a context manager.

    A bar on a terminal, from half a second on, which is cleared at the end; elsewhere a line every ten seconds, also
    where a stage takes longer than that.
    """

    def __init__(self, file: TextIO | None = None, patience: float = 0.5, between: float = 0.1, lines: float = 10.0):
        self._file = sys.stderr if file is None else file
        self._terminal = self._file.isatty()
        self._between = between if self._terminal else 1.0 if LOG.level == logging.DEBUG else lines
        self._start = time.monotonic()
        self._next = self._start + (patience if self._terminal else lines)
        self._bar: Any = None
        self._last: tuple[str, float] | None = None
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._clock = threading.Thread(target=self._tick, daemon=True)

    def __call__(self, what: str, share: float) -> None:
        """Show what is being done and the share 0..1 of the work that is done, if it is time to."""
        with self._lock:
            self._last = what, share
            self._show()

    def _tick(self) -> None:
        """Show what was last begun, until the end."""
        while not self._ended.wait(_TICK):
            with self._lock:
                self._show()

    def _show(self) -> None:
        now = time.monotonic()
        if self._last is None or now < self._next or LOG.level == logging.WARNING:
            return
        self._next = now + self._between
        what, share = self._last
        text = f"{what}: {share:4.0%}, {now - self._start:.0f} s"
        if not self._terminal:
            print(f"puma-sim: {text}", file=self._file, flush=True)
            return
        if self._bar is None:
            self._bar = _new_bar(self._file)
            self._bar.start()
        self._bar.update(self._bar.task_ids[0], description=text, completed=share, refresh=True)

    def __enter__(self) -> Progress:
        self._clock.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._clock.join()
        if self._bar is not None:
            self._bar.stop()


class TimeLeft:
    """A `Progress` that also says about how long a stage will take, from what it has done since it was begun here."""

    def __init__(self, shown: Progress):
        self._shown = shown
        self._begun: dict[str, tuple[float, float]] = {}

    def __call__(self, what: str, share: float) -> None:
        """Show what is being done, the share 0..1 of the work that is done, and the time left."""
        now = time.monotonic()
        start, before = self._begun.setdefault(what, (now, share))
        left = ""
        if share > before and now > start:
            seconds = (now - start) * (1.0 - share) / (share - before)
            left = f", about {seconds:.0f} s left" if seconds < 100.0 else f", about {seconds / 60.0:.0f} min left"
        self._shown(what + left, share)


def _new_bar(file: TextIO) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn
    from rich.progress import Progress as Bar

    console = Console(file=file, force_terminal=True)
    found = Bar(BarColumn(24), "{task.description}", console=console, auto_refresh=False, transient=True)
    found.add_task("", total=1.0)
    return found


#: what identification takes without it: 1012 s of processor time against 33 s for the sample log
#: examples/arm_hidden_effect.csv
WITHOUT_NUMBA = (
    "numba is not installed: what takes a minute with it takes half an hour without; pip install 'puma_sim_ros[fast]'"
)


def start_at_once(patient: bool = False, trials: bool = False) -> Compilation:
    """Begin as plain Python where the model is not compiled yet, or wait for it when it is needed (patient); say so on
    standard error. trials : what an appraisal runs is needed, not what `explain` does."""
    from puma_sim_core import jit
    from puma_sim_core.compiling import Compilation, lacks_numba

    if patient and lacks_numba():
        LOG.warning("puma-sim: %s", WITHOUT_NUMBA)
    return Compilation(
        lambda text: LOG.info("puma-sim: %s", text), patient=patient, parts=jit.APPRAISAL_PARTS if trials else jit.PARTS
    )
