# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Titles, rows, figures, sentences and printed numbers of experiments, from words/MODULE.yaml.

A file has these sections, each a mapping by key::

  experiments: {"7.2": {title: , chapter: , summary: }}        chapter: the number, if left out
  rows: {key: {quantity: , unit: "", printed: null, ours: , note: ""}}
  figures: {key: {key: , title: , x: , y: , value: , note: "", curves: {name: label}, log: xy, equal: true}}
  texts: {key: sentence}
  tables: {name: numbers and words as they stand}

A text may hold ``{name:.2f}``, as `str.format` has it. One placeholder alone, ``"{name}"``, gives the
value itself. A format of a list is applied to each item, with commas between them. In the place of a
text, a mapping gives one text a case; `case` chooses, and what has no text of its own is `else`.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from string import Formatter
from typing import Any

import numpy as np

from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml
from puma_sim_core.thesis import registry
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Result, Row

FOLDER = Path(__file__).resolve().parent / "words"
#: fields of the entries of each section with their defaults, `...` where one must be given; an entry of
#: a section without fields is the text itself, or whatever the table holds
FIELDS: dict[str, dict[str, Any]] = {
    "experiments": {"title": ..., "chapter": None, "summary": ...},
    "rows": {"quantity": ..., "unit": "", "printed": None, "ours": None, "note": ""},
    "figures": dict.fromkeys(("title", "x", "y"), ...)
    | {"key": "", "value": "", "note": "", "curves": {}, "log": "", "equal": False},
    "texts": {},
    "tables": {},
}


class _Formatter(Formatter):
    def format_field(self, value: Any, format_spec: str) -> Any:
        if format_spec and isinstance(value, (list, tuple, np.ndarray)):
            return ", ".join(format(each, format_spec) for each in value)
        return super().format_field(value, format_spec)


class Words:
    """The words of one module of experiments.

    ParameterError : a section, field or placeholder is unknown or missing; it names the file, the key and
    what was expected.
    """

    def __init__(self, module: str, folder: Path = FOLDER) -> None:
        self.path = folder / f"{module.rpartition('.')[2]}.yaml"
        self.content: dict[str, dict[str, Any]] = read_yaml(self.path)
        for section, entries in self.content.items():
            fields = FIELDS[self._known(section, FIELDS, section)]
            for key, entry in entries.items() if fields else ():
                for name in (*entry, *(name for name, default in fields.items() if default is ...)):
                    self._known(name, fields if name in entry else entry, f"{section}, {key}")

    def experiment(self, number: str) -> Callable[[registry.Run], registry.Run]:
        """Register ``run(context) -> Result`` under a section number of the thesis."""
        entry = self._entry("experiments", number)
        return registry.experiment(number, entry["title"], chapter=entry.get("chapter"))

    def result(
        self,
        number: str,
        rows: Iterable[Row],
        figures: Iterable[Figure | Heatmap] = (),
        numbers: Mapping[str, Any] | None = None,
        /,
        *,
        page_rows: Iterable[Row] = (),
        case: Any = None,
        **values: Any,
    ) -> Result:
        """The result of an experiment, with its summary."""
        summary = self._filled("experiments", number, case, values)["summary"]
        return Result(summary, tuple(rows), tuple(figures), numbers or {}, tuple(page_rows))

    def row(self, key: str, ours: Any = None, /, *, case: Any = None, agrees: bool | None = None, **values: Any) -> Row:
        """A row with our number; without one, the entry's ``ours`` is filled."""
        entry = self._filled("rows", key, case, values)
        if (ours is None) == (entry["ours"] is None):
            raise self._error("ours is missing or given twice", f"rows, {key}", "one, in the code or in the file")
        ours = entry["ours"] if ours is None else ours
        return Row(entry["quantity"], entry["unit"], entry["printed"], ours, entry["note"], agrees)

    def figure(self, key: str, curves: Iterable[Curve], /, *, case: Any = None, **values: Any) -> Figure:
        """A figure; labels of curves are names in its ``curves``, or stand as they are if it has none."""
        entry = self._filled("figures", key, case, values)
        if labels := entry["curves"]:
            place = f"figures, {key}, curves"
            curves = [replace(curve, label=labels[self._known(curve.label, labels, place)]) for curve in curves]
        words = (entry["key"] or key, entry["title"], entry["x"], entry["y"])
        return Figure(
            *words, tuple(curves), entry["note"], "x" in entry["log"], "y" in entry["log"], equal=entry["equal"]
        )

    def heatmap(
        self, key: str, x: np.ndarray, y: np.ndarray, z: np.ndarray, /, *, case: Any = None, **values: Any
    ) -> Heatmap:
        """A map of one value over two axes."""
        entry = self._filled("figures", key, case, values)
        words = (entry["key"] or key, entry["title"], entry["x"], entry["y"])
        return Heatmap(*words, x, y, z, entry["value"], entry["note"])

    def text(self, key: str, /, *, case: Any = None, **values: Any) -> str:
        """A sentence or a phrase."""
        return str(self._filled("texts", key, case, values)["text"])

    def table(self, name: str) -> Any:
        """Numbers and words as they stand in the file."""
        return self._entry("tables", name)

    def _error(self, what: str, place: str, expected: str) -> ParameterError:
        return ParameterError(what, where=f"{self.path.name}, {place}", expected=expected)

    def _known(self, name: Any, names: Iterable[Any], place: str) -> Any:
        if name not in names:
            raise self._error(f"there is no {name!r}", place, f"one of {', '.join(sorted(map(str, names)))}")
        return name

    def _entry(self, section: str, key: str) -> Any:
        entries = self.content.get(section, {})
        return entries[self._known(key, entries, section)]

    def _filled(self, section: str, key: str, case: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        """The entry with its defaults, the texts of the case and all values in their places."""
        entry, place = self._entry(section, key), f"{section}, {key}"
        entry = entry if FIELDS[section] else {"text": entry}
        cases = [name for name, each in entry.items() if isinstance(each, Mapping) and name != "curves"]
        if bool(cases) != (case is not None):
            raise self._error(f"case {case!r}", place, "one, as the entry has cases" if cases else "none")
        texts = _texts(entry)
        used = {re.split(r"[.\[]", name)[0] for text in texts for _, name, _, _ in Formatter().parse(text) if name}
        if unused := set(values) - used:
            raise self._error(f"no text uses {', '.join(sorted(unused))}", place, f"some of {sorted(used)}")
        for name in cases:
            chosen = self._known(
                case if case in entry[name] else "else", entry[name], f"{place}, {name}, case {case!r}"
            )
            entry = {**entry, name: entry[name][chosen]}
        try:
            return {**FIELDS[section], **_formatted(entry, values)}
        except (KeyError, IndexError, AttributeError, TypeError, ValueError) as reason:
            raise self._error(f"a placeholder cannot be filled ({reason})", place, f"values for {texts}") from None


def _texts(content: Any) -> list[str]:
    if isinstance(content, Mapping):
        return [text for each in content.values() for text in _texts(each)]
    return [content] if isinstance(content, str) else []


def _formatted(content: Any, values: Mapping[str, Any]) -> Any:
    if isinstance(content, Mapping):
        return {name: _formatted(each, values) for name, each in content.items()}
    if not isinstance(content, str):
        return content
    if alone := re.fullmatch(r"\{([\w.\[\]]+)\}", content):
        return _Formatter().get_field(alone[1], (), values)[0]
    return _Formatter().vformat(content, (), values)
