# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The folder of a run of many jobs: what was asked, a folder for the files of each job, and a table of all.

``run.json`` has the command, its settings and the jobs; it is written first, and the same for all shards of a run. A
job's folder is there as soon as the job is done: with its files, or with ``error.json``. So a run goes on where it
stopped, and runs of shards are merged by their files.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any

from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.executors import Failure
from puma_sim_core.files import whole_file
from puma_sim_core.json_text import json_text

RUN, SUMMARY, ERROR = "run.json", "summary.csv", "error.json"


class ResultFolder:
    """Results of jobs in a folder.

    path : of the folder; run : command (text), settings (mapping), jobs (list of mappings with ``name``, the folder of
    the job, ``source``, what it is of, and ``sha256`` of that).
    """

    def __init__(self, path: str | os.PathLike[str], run: Mapping[str, Any]):
        self.path = Path(path)
        self.run = json.loads(json.dumps(run))

    @classmethod
    def opened(cls, path: str | os.PathLike[str]) -> ResultFolder:
        """The folder of an earlier run.

        Raises RecordingError: there is none, or its run.json cannot be used.
        """
        expected = "the folder of a run of many jobs, with its run.json"
        try:
            run = json.loads((Path(path) / RUN).read_text(encoding="utf-8"))
            names = [job["name"] for job in run["jobs"] if job["source"] and job["sha256"]]
            if not (isinstance(run["settings"], dict) and isinstance(run["command"], str) and names):
                raise ValueError("no jobs")
        except OSError as error:
            raise RecordingError(f"no {RUN} ({error.strerror})", where=str(path), expected=expected) from None
        except (ValueError, KeyError, TypeError) as error:
            raise RecordingError(f"{RUN} cannot be used ({error})", where=str(path), expected=expected) from None
        return cls(path, run)

    @property
    def names(self) -> list[str]:
        """The folders of the jobs, in their order."""
        return [job["name"] for job in self.run["jobs"]]

    def begin(self) -> None:
        """Make the folder, or go on with that of an earlier run, to which jobs may have been added.

        Raises RecordingError: the folder has something else, or results of another run; it says what differs.
        """
        if (self.path / RUN).exists():
            self.check_same(ResultFolder.opened(self.path), added=True)
        elif self.path.is_dir() and any(self.path.iterdir()):
            raise RecordingError("is not empty, and not of such a run", where=str(self.path), expected="a new folder")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            expected = "a folder, there or to be made"
            raise RecordingError(
                f"cannot be made ({error.strerror})", where=str(self.path), expected=expected
            ) from None
        self._write(RUN, json_text(self.run))

    def check_same(self, before: ResultFolder, added: bool = False) -> None:
        """Refuse an earlier run of something else; added : this one may have further jobs.

        Raises RecordingError: names what differs.
        """
        where, expected = str(before.path), "the same command and options, or another folder"
        theirs, ours = ({"command": run["command"], **run["settings"]} for run in (before.run, self.run))
        for name in sorted({*theirs, *ours}):
            if theirs.get(name) != ours.get(name):
                what = f"{name} was {_said(theirs.get(name))}, and is {_said(ours.get(name))} now"
                raise RecordingError(what, where=where, expected=expected)
        now = {job["name"]: job for job in self.run["jobs"]}
        for job in before.run["jobs"]:
            if job["name"] not in now:
                expected = "all that the folder was made of, or another folder"
                raise RecordingError(f"has {job['source']}, which is not given now", where=where, expected=expected)
            if job["sha256"] != now[job["name"]]["sha256"]:
                expected = "the same file, or another folder"
                raise RecordingError(f"{job['source']} has changed since", where=where, expected=expected)
        if not added and len(now) != len(before.run["jobs"]):
            new = next(job for name, job in now.items() if name not in before.names)
            raise RecordingError(f"lacks {new['source']}", where=where, expected="shards of one and the same command")

    def is_done(self, name: str) -> bool:
        """Whether a job has its files, or an error that would come again."""
        return (self.path / name).is_dir()

    def write(self, name: str, result: Mapping[str, str] | Failure) -> None:
        """Write the folder of a job: files {name: text}, or the error; nothing for a process that died.

        Raises RecordingError: it cannot be written.
        """
        if isinstance(result, Failure):
            if result.died:
                return
            result = {ERROR: json_text({"error": result.reason, "trace": result.trace})}
        try:
            with tempfile.TemporaryDirectory(prefix=".new-", dir=self.path) as temporary:
                whole = Path(temporary) / name
                whole.mkdir(parents=True)
                for file, text in result.items():
                    (whole / file).write_text(text, encoding="utf-8", newline="")
                _place(whole, self.path / name)
        except OSError as error:
            what, expected = f"cannot be written ({error.strerror})", "a folder with room in it"
            raise RecordingError(what, where=str(self.path / name), expected=expected) from None

    def error(self, name: str) -> str | None:
        """Why a job has no result; None where it has one."""
        path = self.path / name / ERROR
        return json.loads(path.read_text(encoding="utf-8"))["error"] if path.exists() else None

    def write_summary(self, columns: Sequence[str], rows: Sequence[Sequence[str]], name: str = SUMMARY) -> Path:
        """Write summary.csv, or a table of another name; returns its path."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([columns, *rows])
        self._write(name, text.getvalue())
        return self.path / name

    def _write(self, name: str, text: str) -> None:
        with whole_file(self.path / name, RecordingError) as file:
            file.write(text)


def _said(value: Any) -> str:
    return "not given" if value is None else shorten(str(value), 80)


def _place(whole: Path, path: Path) -> None:
    """Rename a folder to its place, unless another process was there first."""
    path.parent.mkdir(exist_ok=True)
    try:
        whole.rename(path)
    except OSError:
        if not path.is_dir():
            raise


def merged(paths: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]) -> ResultFolder:
    """Results of the shards of one run in a folder, which may be one of theirs.

    Raises
    ------
    RecordingError : the folders are of different runs, a job has different results in two of them, or none.
    """
    folders = [ResultFolder.opened(path) for path in paths]
    target = ResultFolder(out, folders[0].run)
    for folder in folders[1:]:
        target.check_same(folder)
    sources: dict[str, Path] = {}
    for folder in folders:
        for name in filter(folder.is_done, folder.names):
            first = sources.setdefault(name, folder.path / name)
            if _contents(first) != _contents(folder.path / name):
                what = f"differs from {first}"
                raise RecordingError(what, where=str(folder.path / name), expected="the same result in all folders")
    missing = [job["source"] for job in target.run["jobs"] if job["name"] not in sources]
    if missing:
        what = f"no result of {len(missing)} of {len(target.names)}: {', '.join(missing[:5])}"
        expected = "the folders of all shards, each of them finished"
        raise RecordingError(what + (" ..." if len(missing) > 5 else ""), where="merge", expected=expected)
    target.begin()
    for name, source in sources.items():
        if not target.is_done(name):
            with tempfile.TemporaryDirectory(prefix=".new-", dir=target.path) as temporary:
                _place(Path(shutil.copytree(source, Path(temporary) / name)), target.path / name)
    return target


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def job_names(sources: Sequence[str]) -> list[str]:
    """Names of folders for files: their names without the ending.

    Raises ParameterError: a file that is not there, two with the same name, or one that a folder cannot have.
    """
    missing = [path for path in sources if not os.path.exists(path)]
    if missing:
        others = f", nor {len(missing) - 1} of the other {len(sources) - 1}" if len(missing) > 1 else ""
        what = f"there is no such file{others}"
        raise ParameterError(what, where=missing[0], expected="files, or folders of bags")
    taken: dict[str, str] = {}
    for path in sources:
        name = Path(os.path.abspath(path)).stem
        if name.startswith(".") or not name or name.lower() in (RUN, SUMMARY):
            raise ParameterError(f"'{name}' is no name for a folder", where=path, expected="another name of the file")
        # not every disk tells capitals from small letters
        other = taken.get(name.lower())
        if other is not None:
            what = "stands twice" if os.path.samefile(other, path) else f"has the name of {other}"
            expected = f"each file once, and names of their own: the folder of the results is '{name}'"
            raise ParameterError(what, where=path, expected=expected)
        taken[name.lower()] = path
    return [Path(os.path.abspath(path)).stem for path in sources]


def digest(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file, or of all files of a folder with their names.

    Raises RecordingError: it cannot be read.
    """
    found = hashlib.sha256()
    path = Path(path)
    try:
        for file in sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]:
            if path.is_dir():
                found.update(file.relative_to(path).as_posix().encode() + b"\0")
            with open(file, "rb") as content:
                while chunk := content.read(1 << 20):
                    found.update(chunk)
    except OSError as error:
        expected = "a file that can be read"
        raise RecordingError(f"cannot be read ({error.strerror})", where=str(path), expected=expected) from None
    return found.hexdigest()
