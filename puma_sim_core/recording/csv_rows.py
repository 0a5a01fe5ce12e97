# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""CSV text as recordings and logs read it: fields, numbers, and long files in blocks of rows."""

from __future__ import annotations

import csv
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from math import nan

import numpy as np

from puma_sim_core.errors import RecordingError

#: characters that are taken from a file at once
_CHUNK = 1 << 22
#: a line that is longer is no row of numbers
_GREATEST_LINE = 1_000_000


def fields_of(line: str, path: str | os.PathLike, number: int) -> list[str]:
    """Fields of one line; raises RecordingError, which names the line."""
    try:
        return next(csv.reader([line]))
    except csv.Error as error:
        raise RecordingError(
            f"is not CSV ({error})", where=f"{path}, line {number}", expected="fields between commas"
        ) from None


def check_count(fields: Sequence[str], names: Sequence[str], path: str | os.PathLike, number: int) -> None:
    """Raise RecordingError where a line has another number of fields than there are columns."""
    if len(fields) != len(names):
        raise RecordingError(
            f"{len(fields)} {'field' if len(fields) == 1 else 'fields'}",
            where=f"{path}, line {number}",
            expected=f"{len(names)} numbers, one a column",
        )


def number_of(field: str, where: str) -> float:
    """The number in a field, NaN and infinity included; raises RecordingError."""
    try:
        if "_" in field:  # which float() takes, as Python's own numbers do
            raise ValueError
        return float(field)
    except ValueError:
        raise RecordingError(f"'{field.strip()}'", where=where, expected="a number") from None


@dataclass(frozen=True)
class Block:
    """Rows of a file: values (m, columns) and lines (m,), their line numbers from 1 on."""

    values: np.ndarray
    lines: np.ndarray


class CsvRows:
    """Rows of a CSV file of any length, in blocks.

    Lines that are blank or begin with '#' are skipped; the first other line names the columns.
    ``names`` are those; ``names_line`` is their line; ``cut`` turns True when the last row has no
    line end, as in a file that was cut off or is still being written.

    Raises
    ------
    RecordingError : the file cannot be read, is not text, is empty.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = path
        self.cut = False
        self._chunks = self._lines()
        for first, lines in self._chunks:
            kept = _rows_among(lines)
            if kept:
                self.names_line = first + kept[0]
                self.names = [name.strip() for name in fields_of(lines[kept[0]], path, self.names_line)]
                self._begun = (self.names_line + 1, lines[kept[0] + 1 :])
                return
        raise RecordingError("is empty", where=str(path), expected="a line of column names")

    def blocks(self, columns: Sequence[int]) -> Iterator[Block]:
        """Blocks of rows with these columns. An empty field is a NaN.

        Raises
        ------
        RecordingError : a text where a number belongs, or a row with another number of fields;
            names the line and the column.
        """
        for first, lines in chain([self._begun], self._chunks):
            yield from self._block(first, lines, columns)

    def _block(self, first, lines, columns) -> Iterator[Block]:
        kept = _rows_among(lines)
        if kept:
            rows = lines if len(kept) == len(lines) else [lines[i] for i in kept]
            numbers = first + np.array(kept)
            values = self._quick(rows, columns)
            if values is None:
                values = np.array([self._row(line, columns, int(number)) for line, number in zip(rows, numbers)])
            yield Block(values, numbers)

    def _quick(self, rows, columns) -> np.ndarray | None:
        """Values by NumPy's reader, or None where anything is unusual."""
        commas = len(self.names) - 1
        if any(row.count(",") != commas for row in rows):
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                return np.loadtxt(rows, delimiter=",", comments=None, ndmin=2, usecols=columns)
        except (ValueError, UserWarning):
            return None

    def _row(self, line, columns, number) -> list[float]:
        fields = fields_of(line, self.path, number)
        check_count(fields, self.names, self.path, number)
        return [
            number_of(fields[c], f"{self.path}, line {number}, column {self.names[c]}") if fields[c].strip() else nan
            for c in columns
        ]

    def _lines(self) -> Iterator[tuple[int, list[str]]]:
        """(number of the first line, lines without their ends), chunk by chunk."""
        number, rest = 1, ""
        try:
            with open(self.path, encoding="utf-8-sig") as file:
                while text := file.read(_CHUNK):
                    if "\0" in text:
                        raise RecordingError(
                            "is not text (it holds zero bytes)", where=str(self.path), expected="a CSV file"
                        )
                    lines = (rest + text).split("\n")
                    rest = lines.pop()
                    if len(rest) > _GREATEST_LINE:
                        raise RecordingError(
                            f"a line of more than {_GREATEST_LINE} characters",
                            where=f"{self.path}, line {number + len(lines)}",
                            expected="rows of numbers",
                        )
                    yield number, lines
                    number += len(lines)
        except OSError as error:
            raise RecordingError(
                f"cannot be read ({error.strerror})", where=str(self.path), expected="a CSV file"
            ) from None
        except UnicodeDecodeError:
            raise RecordingError("is not text", where=str(self.path), expected="a CSV file") from None
        if rest.strip():
            self.cut = True
            yield number, [rest]


def _rows_among(lines) -> list[int]:
    """Places of the lines that are neither blank nor comments."""
    return [i for i, line in enumerate(lines) if (stripped := line.lstrip()) and stripped[0] != "#"]
