# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs as tables of text files: unpacked, cut to a stretch, changed, written again."""

from __future__ import annotations

import gzip
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rigs.catalogue import Log


@dataclass(frozen=True)
class Table:
    """Columns of a CSV file: names, values (n, k)."""

    name: str
    names: tuple[str, ...]
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.values)

    def column(self, name: str) -> np.ndarray:
        """(n,) values of a column."""
        return self.values[:, self.names.index(name)]

    def with_columns(self, **columns: np.ndarray) -> Table:
        """The table with columns replaced, or added at the end."""
        values, names = self.values.copy(), list(self.names)
        for name, column in columns.items():
            if name in names:
                values[:, names.index(name)] = column
            else:
                values, names = np.column_stack([values, column]), [*names, name]
        return replace(self, names=tuple(names), values=values)

    def rows(self, rows: slice | np.ndarray) -> Table:
        """The table with some of its rows."""
        return replace(self, values=self.values[rows])


def read_table(path: str | Path) -> Table:
    """Read a CSV file, compressed or not; lines that begin with # are comments."""
    path = Path(path)
    content = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    lines = [line for line in content.decode().splitlines() if line.strip() and not line.startswith("#")]
    names = tuple(name.strip() for name in lines[0].split(","))
    values = np.array([[float(field or "nan") for field in line.split(",")] for line in lines[1:]])
    return Table(path.name.removesuffix(".gz").removesuffix(".csv"), names, values)


def write_table(table: Table, folder: str | Path) -> Path:
    """Write a table as CSV, each number so that it is read back as it was; returns its path."""
    path = Path(folder) / f"{table.name.replace(' ', '_')}.csv"
    lines = [",".join(map(repr, row)) for row in table.values.tolist()]
    path.write_text("\n".join([",".join(table.names), *lines]) + "\n", encoding="utf-8")
    return path


def stretch(table: Table, time: str, begin: float | None, end: float | None) -> Table:
    """The rows from begin on and before end [s], by the column of times, which stays as it is."""
    t = table.column(time)
    rows = (t >= (-np.inf if begin is None else begin)) & (t < (np.inf if end is None else end))
    return table.rows(rows)


def table_of(log: Log, data: str | Path, time: str) -> Table:
    """The table of a log below the data folder, cut to its stretch."""
    whole = read_table(Path(data) / log.file)
    return replace(stretch(whole, time, log.begin, log.end), name=log.label)


def as_file(log: Log, data: str | Path, time: str, folder: str | Path) -> Path:
    """The path of a log as `read_log` takes it: the file itself where it is whole and not compressed."""
    path = Path(data) / log.file
    if path.suffix != ".gz" and log.begin is None and log.end is None:
        return path
    return write_table(table_of(log, data, time), folder)
