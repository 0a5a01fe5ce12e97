# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Where the output of a command goes, and the line that shows how far it is."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TextIO

from puma_sim_core.errors import PumaSimError, RecordingError
from puma_sim_core.files import is_special, whole_file

#: a command that takes less than this shows no progress [s]
_PATIENCE = 0.5
_BETWEEN = 0.1
_BAR = 24


def check_output(path: str, inputs: Iterable[str] = ()) -> None:
    """Refuse, before the work, a path that cannot be written or that is one of the inputs.

    Raises
    ------
    RecordingError : names the path.
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

    Raises
    ------
    error : the file cannot be written; names it.
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
        raise error(
            f"cannot be written ({reason.strerror})", where="standard output", expected="a place that takes the output"
        ) from None


class Progress:
    """One changing line on standard error while a command works; nothing where that is no
    terminal, or where the command is quick. A context manager, which clears the line."""

    def __init__(self, file: TextIO | None = None):
        self._file = sys.stderr if file is None else file
        self._shown = False
        self._start = time.monotonic()
        self._next = self._start + _PATIENCE if self._file.isatty() else float("inf")

    def __call__(self, what: str, done: int, total: int) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + _BETWEEN
        self._shown = True
        share = done / total if total else 1.0
        self._file.write(f"\r\x1b[K{what}: {share:4.0%}, {now - self._start:.0f} s")
        self._file.flush()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_) -> None:
        if self._shown:
            self._file.write("\r\x1b[K")
            self._file.flush()


def bar(what: str, share: float) -> str:
    """A bar as long as the share of the work that is done, and what is being done."""
    done = round(_BAR * min(max(share, 0.0), 1.0))
    return f"[{'#' * done}{'.' * (_BAR - done)}] {what}"


def announce_compilation() -> None:
    """Say on standard error that a first run takes longer, where it will."""
    from puma_sim_core.jit import compiles_first

    if compiles_first():
        print("puma-sim: compiling the model, some twenty seconds; later runs load it", file=sys.stderr)
