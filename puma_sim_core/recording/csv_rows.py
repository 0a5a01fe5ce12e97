# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The one reader of CSV text: comments, header, numbers, and long files in blocks of rows.

A file is UTF-8 with a comma between fields, or a semicolon or a tab, and then numbers may have a decimal comma. Lines
that are blank or begin with '#' are skipped; the first other line names the columns. Units are those of the columns'
names: nothing is converted. Errors name the file, the line and the column.
"""

import csv
import os
import warnings
from collections.abc import Iterator, Sequence
from itertools import chain
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from puma_sim_core.errors import RecordingError

#: characters that are taken from a file at once
_CHUNK = 1 << 22
#: what may stand between fields; the one that splits the names into most of them does
_DELIMITERS = (",", ";", "\t")
#: a line that is longer is no row of numbers
_GREATEST_LINE = 1_000_000


class Block(NamedTuple):
    """Rows of a file."""

    values: np.ndarray  #: (m, columns)
    lines: np.ndarray  #: (m,) line numbers, from 1 on


class CsvRows:
    """Rows of a CSV file of any length, in blocks.

    Raises RecordingError: the file cannot be read, is not text, is empty.
    """

    names: list[str]  #: of the columns
    names_line: int  #: on which they stand
    delimiter: str  #: between fields

    def __init__(self, path: str | os.PathLike[str]):
        self.path = path
        self.cut = False  #: the last row has no line end: the file was cut off or is still being written
        self._chunks = self._lines()
        for first, lines in self._chunks:
            kept = _rows_among(lines)
            if kept:
                self.names_line = first + kept[0]
                self.delimiter = max(_DELIMITERS, key=lines[kept[0]].count)
                self.names = [name.strip() for name in self._fields(lines[kept[0]], self.names_line)]
                self._begun = (self.names_line + 1, lines[kept[0] + 1 :])
                return
        raise self._error("is empty", "a line of column names")

    def blocks(self, columns: Sequence[int], finite: bool = False) -> Iterator[Block]:
        """Blocks of rows with these columns. An empty field is a NaN; `finite` refuses it, NaN and infinities.

        Raises RecordingError: a text where a number belongs, or a row with another number of fields.
        """
        for first, lines in chain([self._begun], self._chunks):
            kept = _rows_among(lines)
            if kept:
                rows = lines if len(kept) == len(lines) else [lines[i] for i in kept]
                numbers = first + np.array(kept)
                values = self._quick(rows, columns)
                if values is None or (finite and not np.isfinite(values).all()):
                    values = np.array([self._row(*row, columns, finite) for row in zip(rows, numbers.tolist())])
                yield Block(values, numbers)

    def _error(self, what: str, expected: str, line: int | None = None, column: int | None = None) -> RecordingError:
        where = str(self.path) if line is None else f"{self.path}, line {line}"
        where += "" if column is None else f", column {self.names[column]}"
        return RecordingError(what, where=where, expected=expected)

    def _fields(self, line: str, number: int) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self.delimiter))
        except csv.Error as error:
            raise self._error(f"is not CSV ({error})", f"fields between {self.delimiter!r}", number) from None

    def _point(self, text: str) -> str:
        """The text with decimal points."""
        return text if self.delimiter == "," else text.replace(",", ".")

    def _quick(self, rows: list[str], columns: Sequence[int]) -> np.ndarray | None:
        """Values by NumPy's reader, which gives the bits of float(); None where anything is unusual."""
        between = len(self.names) - 1
        if any(row.count(self.delimiter) != between for row in rows):
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                text = map(self._point, rows)
                return np.loadtxt(text, delimiter=self.delimiter, comments=None, ndmin=2, usecols=columns)
        except (ValueError, UserWarning):
            return None

    def _row(self, line: str, number: int, columns: Sequence[int], finite: bool) -> list[float]:
        fields = self._fields(line, number)
        if len(fields) != len(self.names):
            what = f"{len(fields)} field{'s' * (len(fields) != 1)}"
            raise self._error(what, f"{len(self.names)} numbers, one a column", number)
        values = []
        for column in columns:
            field = self._point(fields[column].strip())
            try:
                # float() takes 1_000, as Python's own numbers do
                values.append(nan if not (field or finite) else float(field.replace("_", "x")))
            except ValueError:
                raise self._error(f"'{field}'", "a number", number, column) from None
            if finite and not isfinite(values[-1]):
                raise self._error(field, "a finite number", number, column)
        return values

    def _lines(self) -> Iterator[tuple[int, list[str]]]:
        """(number of the first line, lines without their ends), chunk by chunk."""
        number, rest = 1, ""
        try:
            with open(self.path, encoding="utf-8-sig") as file:
                while text := file.read(_CHUNK):
                    if "\0" in text:
                        raise self._error("is not text (it holds zero bytes)", "a CSV file")
                    lines = (rest + text).split("\n")
                    rest = lines.pop()
                    if len(rest) > _GREATEST_LINE:
                        what = f"a line of more than {_GREATEST_LINE} characters"
                        raise self._error(what, "rows of numbers", number + len(lines))
                    yield number, lines
                    number += len(lines)
        except OSError as error:
            raise self._error(f"cannot be read ({error.strerror})", "a CSV file") from None
        except UnicodeDecodeError:
            raise self._error("is not text", "a CSV file") from None
        if rest.strip():
            self.cut = True
            yield number, [rest]


def _rows_among(lines: list[str]) -> list[int]:
    """Places of the lines that are neither blank nor comments."""
    return [i for i, line in enumerate(lines) if (stripped := line.lstrip()) and stripped[0] != "#"]
