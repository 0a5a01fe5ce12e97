# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The one reader of CSV text: comments, header, numbers, and long files in blocks of rows.

A file is UTF-8, packed by gzip or not, with a comma between fields, or a semicolon or a tab, and then numbers may have
a decimal comma. Lines that are blank or begin with "#" are skipped; the first other line names the columns. The files
of measuring programs may also have a title before the names, units in the line behind them, and dates of ISO 8601 for
times. Nothing is converted. Errors name the file, the line and the column.
"""

import csv
import gzip
import io
import os
import re
import warnings
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from math import isfinite, nan
from typing import BinaryIO, NamedTuple, TextIO, cast

import numpy as np

from puma_sim_core.errors import RecordingError

#: characters that are taken from a file at once
_CHUNK = 1 << 22
#: what may stand between fields; the one that splits the names into most of them does
_DELIMITERS = (",", ";", "\t")
#: what to do about numbers with commas
_COMMAS = "; where numbers have decimal commas, a semicolon or a tab between them"
#: a line that is longer is no row of numbers
_GREATEST_LINE = 1_000_000
#: the names of columns are among the first so many lines
_HEADER = 20
#: a date and time of ISO 8601, with a time zone or without
_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?)(?:Z|([+-])(\d\d):?(\d\d))?")


class Block(NamedTuple):
    """Rows of a file."""

    values: np.ndarray  #: (m, columns)
    lines: np.ndarray  #: (m,) line numbers, from 1 on


class CsvRows:
    """Rows of a CSV file of any length, in blocks; measured: titles, a line of units, and dates may stand in it.

    Raises RecordingError: the file cannot be read, is not text, is empty.
    """

    names: list[str]  #: of the columns
    names_line: int  #: on which they stand
    delimiter: str  #: between fields
    units: list[str]  #: of the columns, "" where the file has no line of units
    title: int  #: lines before the names that were skipped

    def __init__(self, path: str | os.PathLike[str], measured: bool = False):
        self.path, self._measured = path, measured
        self._origin: np.datetime64 | None = None
        self.cut = False  #: the last row has no line end: the file was cut off or is still being written
        self._chunks = self._lines()
        for first, lines in self._chunks:
            kept = _rows_among(lines)
            if kept:
                self.title = _title([lines[i] for i in kept[:_HEADER]]) if measured else 0
                at = kept[self.title]
                self.names_line = first + at
                self.delimiter = _delimiter(lines[at])
                self.names = [name.strip() for name in self._fields(lines[at], self.names_line)]
                self.units, behind = [""] * len(self.names), kept[self.title + 1 :]
                if measured and behind and (units := self._units(lines[behind[0]], first + behind[0])):
                    self.units, at = units, behind[0]
                self.units_line = first + at
                self._begun = (first + at + 1, lines[at + 1 :])
                return
        raise self._error("is empty", "a line of column names")

    def blocks(self, columns: Sequence[int], finite: bool = False) -> Iterator[Block]:
        """Blocks of rows with these columns. An empty field is a NaN; `finite` refuses it, NaN and infinities. A date
        in the first of the columns of a measured file is the time [s] since the first date.

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

    def _units(self, line: str, number: int) -> list[str]:
        """The units in a line, [] of one that is no line of units: as many fields as names, and none is a number."""
        fields = [field.strip() for field in self._fields(line, number)]
        texts = [field for field in fields if field]
        if len(fields) != len(self.names) or not texts or any(_number(t) or _DATE.fullmatch(t) for t in texts):
            return []
        return [field.strip("[]() ") for field in fields]

    def _since_first(self, text: str) -> float | None:
        """The time [s] of a date since the first one, None of a text that is no date."""
        found = _DATE.fullmatch(text)
        try:
            moment = np.datetime64(f"{found[1]}T{found[2]}", "ns") if found else None
        except ValueError:
            moment = None
        if found is None or moment is None:
            return None
        if found[3]:
            moment -= np.timedelta64(int(f"{found[3]}1") * (60 * int(found[4]) + int(found[5])), "m")
        if self._origin is None:
            self._origin = moment
        return float((moment - self._origin) / np.timedelta64(1, "ns")) * 1e-9

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
            hint = _COMMAS if self.delimiter == "," and len(fields) > len(self.names) else ""
            raise self._error(what, f"{len(self.names)} numbers, one a column{hint}", number)
        values = []
        for place, column in enumerate(columns):
            field = self._point(fields[column].strip())
            try:
                # float() takes 1_000, as Python's own numbers do
                values.append(nan if not (field or finite) else float(field.replace("_", "x")))
            except ValueError:
                time = self._since_first(field) if self._measured and place == 0 else None
                if time is None:
                    expected = "a number, or a date such as 2026-01-31T12:00:00.5" if "-" in field[1:] else "a number"
                    expected += _COMMAS if self.delimiter == "," and "," in field else ""
                    raise self._error(f"'{field}'", expected, number, column) from None
                values.append(time)
            if finite and not isfinite(values[-1]):
                raise self._error(field, "a finite number", number, column)
        return values

    def _lines(self) -> Iterator[tuple[int, list[str]]]:
        """(number of the first line, lines without their ends), chunk by chunk."""
        number, rest = 1, ""
        try:
            with _opened(self.path) as file:
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
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise self._error(f"is compressed and damaged ({error})", "a whole gzip file") from None
        except OSError as error:
            raise self._error(f"cannot be read ({error.strerror})", "a CSV file") from None
        except UnicodeDecodeError:
            raise self._error("is not text", "a CSV file in UTF-8") from None
        if rest.strip():
            self.cut = True
            yield number, [rest]


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[TextIO]:
    """A file or a pipe of text, unpacked where its first bytes are those of gzip (RFC 1952)."""
    with open(path, "rb") as file:
        packed = file.peek(2)[:2] == b"\x1f\x8b"
        content = cast(BinaryIO, gzip.GzipFile(fileobj=file) if packed else file)
        with io.TextIOWrapper(content, encoding="utf-8-sig") as text:
            yield text


def _rows_among(lines: list[str]) -> list[int]:
    """Places of the lines that are neither blank nor comments."""
    return [i for i, line in enumerate(lines) if (stripped := line.lstrip()) and stripped[0] != "#"]


def _delimiter(line: str) -> str:
    return max(_DELIMITERS, key=line.count)


def _number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _title(lines: Sequence[str]) -> int:
    """How many lines of text stand before the names: each has fewer fields than these."""
    place, most = 0, 0
    for n, line in enumerate(lines):
        if any(2 * numbers > count for count, numbers in (_counts(line, between) for between in _DELIMITERS)):
            break  # a row, most of whose fields are numbers
        count, _ = _counts(line, _delimiter(line))
        if count > most:
            place, most = n, count
    return place


def _counts(line: str, delimiter: str) -> tuple[int, int]:
    """How many fields of a line are not empty, and how many of these are numbers or dates."""
    fields = [field for field in map(str.strip, next(csv.reader([line], delimiter=delimiter))) if field]
    return len(fields), sum(_number(field) or _DATE.fullmatch(field) is not None for field in fields)
