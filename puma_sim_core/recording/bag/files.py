# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The MCAP files of a bag, read as one: NAME_0.mcap, NAME_1.mcap, ... in the order of their numbers."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import metadata
from puma_sim_core.recording.bag.scan import Damage, RawMessage, Scan

_NUMBERED = re.compile(r"(.*)_(0|[1-9]\d*)\.mcap")


class BagFiles:
    """Reads the messages of all files of a bag in the order in which they were written.

    ``topics`` (name to type), ``begins_ns`` (time of the first message of each file that has one [ns]) and ``damage``
    fill up during `messages`.

    path : the bag's directory, or one MCAP file, which is read alone.
    partial : read what a killed recorder left: ``metadata.yaml`` may be missing, and files may be cut off or missing.

    Raises `BagError`: no bag or, unless ``partial``, one that was not closed or lacks a file.
    """

    def __init__(self, path: Path, partial: bool = False):
        self.path, self._partial = path, partial
        self._counts: dict[str, int] | None = None
        self._absent: list[Path] = []
        if not path.is_dir():
            if not path.exists():
                raise BagError("does not exist", where=path, expected="a bag")
            files = [path]
        elif partial:
            files, self._absent = _found(path)
        else:
            files, self._counts = _listed(path)
        self._scans = [Scan(file, partial) for file in files]
        self.begins_ns: list[int] = []
        for scan in self._scans:
            if not (scan.complete or partial):
                what = f"the file ends at offset {scan.size} without an index; {_hint(path)}"
                raise BagError(what, where=scan.path, expected="a closed bag")

    @property
    def topics(self) -> dict[str, str]:
        """Type of each topic by its name."""
        return {name: kind for scan in self._scans for name, kind in scan.topics.items()}

    @property
    def damage(self) -> list[Damage]:
        """Files that are missing, and what was passed over in the others."""
        absent = [Damage(file, 0, 0, "does not exist") for file in self._absent]
        return [*absent, *(each for scan in self._scans for each in scan.damage)]

    @property
    def fault(self) -> BagError | None:
        """What ended the reading of a file that is read in part, the first of them."""
        return next((scan.fault for scan in self._scans if scan.fault), None)

    @property
    def complete(self) -> bool:
        """Whether each file ends with its index, and nothing was found wrong."""
        return all(scan.complete for scan in self._scans) and self.fault is None and not self.damage

    def messages(self) -> Iterator[RawMessage]:
        """Messages in the order of the files. Raises `BagError` where a file cannot be read on, unless the bag is read
        in part, or where the numbers of messages are not those of ``metadata.yaml``."""
        last = 0
        for scan in self._scans:
            for place, message in enumerate(scan.messages(last)):
                last = message.time_ns
                if place == 0:
                    self.begins_ns.append(last)
                yield message
        if self._counts is not None:
            self._check(self._counts)

    def _check(self, expected: dict[str, int]) -> None:
        counts = sum((scan.counts for scan in self._scans), Counter[str]())
        for topic in sorted(expected.keys() | self.topics.keys()):
            if expected.get(topic) != counts[topic]:
                what, where = f"the bag holds {counts[topic]} messages", f"{self.path}, topic {topic}"
                raise BagError(what, where=where, expected=f"{expected.get(topic)}, as {metadata.NAME} says")


def _listed(directory: Path) -> tuple[list[Path], dict[str, int]]:
    """The files that ``metadata.yaml`` names, which must all be there, and the number of messages by topic."""
    if not (directory / metadata.NAME).exists():
        _all(directory)
        raise BagError(f"{metadata.NAME} is missing; {_hint(directory)}", where=directory, expected="a closed bag")
    files, counts = metadata.read(directory)
    for file in files:
        if not file.is_file():
            raise BagError("does not exist", where=file, expected=f"the file of the bag, as {metadata.NAME} says")
    return files, counts


def _found(directory: Path) -> tuple[list[Path], list[Path]]:
    """The files that are there in the order of their numbers, and those that are known to be missing."""
    try:
        listed, _ = metadata.read(directory)
    except BagError:
        listed = []
    absent = {file for file in listed if not file.is_file()}
    files = _all(directory)
    if len(files) > 1:
        numbered = [(match, file) for file in files if (match := _NUMBERED.fullmatch(file.name))]
        stems = {match[1] for match, _ in numbered}
        if len(stems) != 1 or len(numbered) != len(files):
            what, expected = f"holds {len(files)} MCAP files", "one, or those of one bag: NAME_0.mcap, NAME_1.mcap, ..."
            raise BagError(what, where=directory, expected=expected)
        by_number = {int(match[2]): file for match, file in numbered}
        files = [by_number[number] for number in sorted(by_number)]
        (stem,) = stems
        absent |= {directory / f"{stem}_{number}.mcap" for number in range(len(files)) if number not in by_number}
    return files, sorted(absent)


def _all(directory: Path) -> list[Path]:
    files = list(directory.glob("*.mcap"))
    if not files:
        raise BagError("is not a bag", where=directory, expected=f"{metadata.NAME} and an MCAP file in it")
    return files


def _hint(path: Path) -> str:
    return f"`puma-sim recover {path}` reads what is there"
