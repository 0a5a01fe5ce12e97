# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Where the output of a command goes, and the line that shows how far it is."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from puma_sim_core.errors import PumaSimError, RecordingError
from puma_sim_core.files import is_special, whole_file


def check_output(path: str, inputs: Iterable[str] = ()) -> None:
    """Refuse, before the work, a path that cannot be written or that is one of the inputs.

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


class Progress:
    """What a command does and how far it is, on standard error; a context manager.

    A bar on a terminal, from half a second on, which is cleared at the end; elsewhere a line every ten seconds.
    """

    def __init__(self, file: TextIO | None = None, patience: float = 0.5, between: float = 0.1, lines: float = 10.0):
        self._file = sys.stderr if file is None else file
        self._terminal = self._file.isatty()
        self._between = between if self._terminal else lines
        self._start = time.monotonic()
        self._next = self._start + (patience if self._terminal else lines)
        self._bar: Any = None

    def __call__(self, what: str, share: float) -> None:
        """Show what is being done and the share 0..1 of the work that is done, if it is time to."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + self._between
        text = f"{what}: {share:4.0%}, {now - self._start:.0f} s"
        if not self._terminal:
            print(f"puma-sim: {text}", file=self._file, flush=True)
            return
        if self._bar is None:
            self._bar = _new_bar(self._file)
            self._bar.start()
        self._bar.update(self._bar.task_ids[0], description=text, completed=share, refresh=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()


def _new_bar(file: TextIO) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn
    from rich.progress import Progress as Bar

    console = Console(file=file, force_terminal=True)
    found = Bar(BarColumn(24), "{task.description}", console=console, auto_refresh=False, transient=True)
    found.add_task("", total=1.0)
    return found


def announce_compilation() -> None:
    """Say on standard error that a first run takes longer, where it will."""
    from puma_sim_core.jit import compiles_first

    if compiles_first():
        print("puma-sim: compiling the model, some twenty seconds; later runs load it", file=sys.stderr)
