# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The machines, their runs and expected answers, read from `rigs.yaml`.

An effect is written NAME@JOINT, or NAME for one of the whole machine; a size NAME@JOINT.PARAMETER; `shape:AXIS@JOINT`
stands for something without a name over an axis, such as `shape:time@1`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from puma_sim_core.checks import Reader
from puma_sim_core.files import read_yaml

RIGS = Path(__file__).with_name("rigs.yaml")
FORMAT = "puma-sim rigs 1"
ROLES = ("development", "test")
#: how sure a statement is
SURE = ("construction", "authors", "code", "fit")
#: errors of others that `measures` can compute of an explanation
MEASURES = ("free_run", "windows", "voltage_share")

_RIG = ("title", "folder", "source", "mechanism", "columns", "development_logs", "test_logs", "runs")
_RIG_OPTIONAL = ("mechanism", "columns", "needs", "test_logs")
_RUN = ("name", "role", "logs", "held_out", "spare", "expected", "reference", "variants", "needs")
_RUN_OPTIONAL = ("held_out", "spare", "reference", "variants", "needs")
_EXPECTED = ("verdicts", "names", "beside", "wrong", "others_wrong", "faults", "sizes", "sure", "words", "note")
_SIZE = ("of", "value", "tolerance", "intervals", "unit", "source", "sure")
_REFERENCE = ("value", "unit", "measure", "source", "computed", "seconds", "cutoff", "logs")


@dataclass(frozen=True)
class Log:
    """A log of a machine: the path below the data folder, and the stretch [s] of it that is used."""

    file: str
    begin: float | None = None
    end: float | None = None

    @property
    def label(self) -> str:
        """Name without folder and endings, and the stretch."""
        name = Path(self.file).name.removesuffix(".gz").removesuffix(".csv")
        if self.begin is None and self.end is None:
            return name
        return f"{name} {self.begin or 0:g}-{'end' if self.end is None else f'{self.end:g}'} s"


@dataclass(frozen=True)
class Size:
    """A published size: of an effect's parameter, its unit, the intervals that are right, and where it is from."""

    of: str
    text: str
    intervals: tuple[tuple[float, float], ...]
    unit: str
    source: str
    sure: str


@dataclass(frozen=True)
class Expected:
    """What is right of an answer.

    verdicts : those that are right; names : of each entry one effect must be named; beside : effects that may be named
    besides; wrong : effects that are wrong; others_wrong : so are all that are not listed; faults : channels that a
    refusal must name; sure : see `SURE`; words : the expected answer in one line, where the names are many; note : what
    else is known of it.
    """

    verdicts: tuple[str, ...]
    names: tuple[tuple[str, ...], ...] = ()
    beside: tuple[str, ...] = ()
    wrong: tuple[str, ...] = ()
    others_wrong: bool = False
    faults: tuple[str, ...] = ()
    sizes: tuple[Size, ...] = ()
    sure: tuple[str, ...] = ()
    words: str = ""
    note: str = ""

    @property
    def text(self) -> str:
        """The expected answer in one line."""
        return self.words or "; ".join(" or ".join(names) for names in self.names) or " or ".join(self.verdicts)


@dataclass(frozen=True)
class Reference:
    """The best published or reference error; computed : the measure of ours that is comparable (see `MEASURES`), over
    windows of so many seconds, at a cutoff [Hz] as it was, and over other logs than the fitted ones where they are
    given."""

    value: float
    unit: str
    measure: str
    source: str
    computed: str | None = None
    seconds: float | None = None
    cutoff: float | None = None
    logs: tuple[Log, ...] = ()


@dataclass(frozen=True)
class Run:
    """One question: logs that are explained, held-out logs, and the expected answer."""

    rig: str
    name: str
    role: str
    logs: tuple[Log, ...]
    held_out: tuple[Log, ...]
    spare: tuple[Log, ...]
    expected: Expected
    reference: Reference | None
    variants: bool
    needs: str | None

    @property
    def key(self) -> str:
        """rig/run, which is also where its report stands."""
        return f"{self.rig}/{slug(self.name)}"

    @property
    def split(self) -> str:
        """How the logs are split for validation."""
        if self.held_out:
            return "held-out logs"
        return "one log, blocks" if len(self.logs) == 1 else "several logs, blocks"


@dataclass(frozen=True)
class Rig:
    """A machine with its logs and runs; needs : what the mechanism format lacks to describe it."""

    name: str
    title: str
    folder: str
    source: str
    mechanism: str | None
    columns: Mapping[str, str] | None
    development_logs: tuple[str, ...]
    test_logs: tuple[str, ...]
    needs: str | None
    runs: tuple[Run, ...] = field(default=())


def slug(name: str) -> str:
    """A name as that of a folder."""
    return "-".join("".join(c if c.isalnum() or c in "_." else " " for c in name).split())


def read_rigs(path: str | Path = RIGS) -> dict[str, Rig]:
    """The machines of a file, by name.

    Raises ParameterError: names the key, what is wrong and what was expected.
    """
    reader, mapping = Reader(str(path)), read_yaml(path)
    reader.keys(mapping, "", ("format", "defaults", "rigs"), optional=("defaults",))
    reader.choice(mapping["format"], "format", (FORMAT,))
    return {name: _rig(reader, name, entry) for name, entry in mapping["rigs"].items()}


def _rig(reader: Reader, name: str, entry: Any) -> Rig:
    at = f"rigs.{name}"
    reader.keys(entry, at, (*_RIG, "needs"), optional=_RIG_OPTIONAL)
    if ("mechanism" in entry) == ("needs" in entry):
        reader.fail(at, "mechanism and needs", "one of the two")
    folder = reader.text(entry["folder"], f"{at}.folder", 1)
    runs = [_run(reader, f"{at}.runs[{n}]", name, folder, run, entry) for n, run in enumerate(entry["runs"])]
    if len({run.key for run in runs}) != len(runs):
        reader.fail(f"{at}.runs", "two runs of one name", "a name of its own for each")
    return Rig(
        name=name,
        title=reader.text(entry["title"], f"{at}.title", 1),
        folder=folder,
        source=reader.text(entry["source"], f"{at}.source", 1),
        mechanism=entry.get("mechanism"),
        columns=entry.get("columns"),
        development_logs=tuple(entry["development_logs"]),
        test_logs=tuple(entry.get("test_logs", ())),
        needs=entry.get("needs"),
        runs=tuple(runs),
    )


def _run(reader: Reader, at: str, rig: str, folder: str, entry: Any, machine: Mapping[str, Any]) -> Run:
    reader.keys(entry, at, _RUN, optional=_RUN_OPTIONAL)
    known = {*machine["development_logs"], *machine.get("test_logs", ())}

    def logs(key: str) -> tuple[Log, ...]:
        found = tuple(_log(reader, f"{at}.{key}", folder, each) for each in entry.get(key, ()))
        for log in found:
            if Path(log.file).name not in known:
                reader.fail(f"{at}.{key}", log.file, "one of development_logs or test_logs")
        return found

    role = reader.choice(entry["role"], f"{at}.role", ROLES)
    own = {key: logs(key) for key in ("logs", "held_out", "spare")}
    used = {Path(log.file).name for found in own.values() for log in found}
    if role == "development" and not used <= set(machine["development_logs"]):
        reader.fail(f"{at}.role", "development with a test log", "test")
    if not own["logs"]:
        reader.fail(f"{at}.logs", "none", "one at least")
    return Run(
        rig=rig,
        name=reader.text(entry["name"], f"{at}.name", 1),
        role=role,
        expected=_expected(reader, f"{at}.expected", entry["expected"]),
        reference=_reference(reader, f"{at}.reference", folder, entry.get("reference")),
        variants=bool(entry.get("variants", False)),
        needs=entry.get("needs", machine.get("needs")),
        **own,
    )


def _log(reader: Reader, at: str, folder: str, entry: Any) -> Log:
    """`name.csv`, or a mapping of file, begin and end."""
    if isinstance(entry, str):
        return Log(f"{folder}/{entry}")
    reader.keys(entry, at, ("file", "begin", "end"), optional=("begin", "end"))
    return Log(f"{folder}/{entry['file']}", entry.get("begin"), entry.get("end"))


def _expected(reader: Reader, at: str, entry: Any) -> Expected:
    reader.keys(entry, at, _EXPECTED, optional=set(_EXPECTED) - {"verdicts", "sure"})
    for word in entry["sure"]:
        reader.choice(word, f"{at}.sure", SURE)
    return Expected(
        verdicts=tuple(entry["verdicts"]),
        names=tuple(tuple(names) for names in entry.get("names", ())),
        beside=tuple(entry.get("beside", ())),
        wrong=tuple(entry.get("wrong", ())),
        others_wrong=bool(entry.get("others_wrong", False)),
        faults=tuple(entry.get("faults", ())),
        sizes=tuple(_size(reader, f"{at}.sizes[{n}]", each) for n, each in enumerate(entry.get("sizes", ()))),
        sure=tuple(entry["sure"]),
        words=entry.get("words", ""),
        note=entry.get("note", ""),
    )


def _size(reader: Reader, at: str, entry: Any) -> Size:
    reader.keys(entry, at, _SIZE, optional=("value", "tolerance", "intervals"))
    if "intervals" in entry:
        intervals = [tuple(reader.numbers(pair, f"{at}.intervals", 2)) for pair in entry["intervals"]]
        text = " or ".join(f"{low:g} to {high:g}" for low, high in intervals)
    else:
        value, about = (reader.number(entry[key], f"{at}.{key}") for key in ("value", "tolerance"))
        intervals, text = [(value - about, value + about)], f"{value:g} ± {about:g}"
    source = reader.text(entry["source"], f"{at}.source", 1)
    sure = reader.choice(entry["sure"], f"{at}.sure", SURE)
    return Size(entry["of"], text, tuple(intervals), entry["unit"], source, sure)


def _reference(reader: Reader, at: str, folder: str, entry: Any) -> Reference | None:
    if entry is None:
        return None
    reader.keys(entry, at, _REFERENCE, optional=("computed", "seconds", "cutoff", "logs"))
    if "computed" in entry:
        reader.choice(entry["computed"], f"{at}.computed", MEASURES)
    return Reference(
        value=reader.number(entry["value"], f"{at}.value"),
        unit=entry["unit"],
        measure=reader.text(entry["measure"], f"{at}.measure", 1),
        source=reader.text(entry["source"], f"{at}.source", 1),
        computed=entry.get("computed"),
        seconds=entry.get("seconds"),
        cutoff=entry.get("cutoff"),
        logs=tuple(_log(reader, f"{at}.logs", folder, each) for each in entry.get("logs", ())),
    )


def chosen(rigs: Mapping[str, Rig], only: Iterable[str]) -> list[Rig]:
    """The machines of some names, all without any; raises KeyError with an unknown name."""
    names = list(only) or list(rigs)
    return [rigs[name] for name in names]
