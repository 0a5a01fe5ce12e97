# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The folder that an explanation is written to: all of its files appear, or none."""

import os
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from puma_sim_core.errors import RecordingError
from puma_sim_core.files import whole_file, yaml_text
from puma_sim_core.identify.report.html import page
from puma_sim_core.identify.report.json import report_text
from puma_sim_core.identify.result import Explanation

REPORT, PAGE, MODEL = "report.json", "report.html", "model.yaml"
_EXPECTED = "a folder for the report, there or to be made"


def check_folder(
    folder: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]] = (), *, force: bool = True
) -> None:
    """Refuse, before the work, a folder that cannot be written to or would overwrite an input; unless `force`, one
    that holds a report.

    Raises
    ------
    RecordingError : names the folder or the file.
    """
    folder = Path(folder)
    whole = Path(os.path.abspath(folder))
    above = next(path for path in (whole, *whole.parents) if os.path.lexists(path))
    if not above.is_dir():
        what = "is a file" if above == whole else f"{above} is no folder"
        raise RecordingError(what, where=str(folder), expected=_EXPECTED)
    if not os.access(above, os.W_OK | os.X_OK):
        raise RecordingError(f"{above} cannot be written", where=str(folder), expected=_EXPECTED)
    for path in (folder / name for name in (REPORT, PAGE, MODEL)):
        if path.is_dir():
            raise RecordingError("is a folder", where=str(path), expected="a file, or nothing")
        for other in inputs:
            if path.exists() and os.path.exists(other) and os.path.samefile(path, other):
                raise RecordingError("is an input and would be overwritten", where=str(path), expected="another folder")
    if not force and (folder / REPORT).exists():
        raise RecordingError("holds a report", where=str(folder), expected="another folder, or --force to replace it")


def texts_of(explanation: Explanation) -> dict[str, str]:
    """File name -> content of report.json, report.html and, where there is a model, model.yaml."""
    texts = {REPORT: report_text(explanation), PAGE: page(explanation)}
    if explanation.model is not None:
        texts[MODEL] = yaml_text(explanation.model.to_mapping())  # type: ignore[attr-defined]
    return texts


def write_explanation(explanation: Explanation, folder: str | os.PathLike[str]) -> list[Path]:
    """Write report.json, report.html and, where there is a model, model.yaml; returns their paths.

    The folder is made where it is missing. An earlier model.yaml is removed where this explanation has none.

    Raises
    ------
    RecordingError : the folder or a file cannot be written; names it. Then no file has changed.
    """
    folder = Path(folder)
    check_folder(folder)
    texts = texts_of(explanation)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        raise RecordingError(f"cannot be made ({reason.strerror})", where=str(folder), expected=_EXPECTED) from None
    with ExitStack() as stack:
        # each takes its place when all are on the disk
        for name, content in texts.items():
            file = stack.enter_context(whole_file(folder / name, RecordingError))
            file.write(content)
            file.flush()
    if MODEL not in texts:
        (folder / MODEL).unlink(missing_ok=True)
    return [folder / name for name in texts]
