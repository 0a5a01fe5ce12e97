# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""From measured times to the table, the targets and their text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.task import Row


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of a quantity over the rounds."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values) -> Spread:
        """From one value a round."""
        low, middle, high = np.percentile(np.asarray(values, float), (25.0, 50.0, 75.0))
        return cls(float(middle), float(low), float(high))


@dataclass(frozen=True)
class Result:
    """A measured row.

    time : of `standard` simulated seconds [s]; ratio : that time to the reference row's, round by
    round; difference : greatest distance of its final positions from ours [rad], None where there
    is nothing to compare; tolerance : within which it is the same arm [rad].
    """

    label: str
    ours: bool
    time: Spread
    ratio: Spread
    difference: float | None
    tolerance: float
    note: str

    @property
    def same_arm(self) -> bool:
        """False where the row's arm ends elsewhere than ours."""
        return self.difference is None or self.difference <= self.tolerance


@dataclass(frozen=True)
class Target:
    """What is aimed at: ``value`` at most, or at least, ``bound``; value None: not measured."""

    what: str
    value: Spread | None
    at_most: bool
    bound: float
    unit: str = ""

    @property
    def reached(self) -> bool | None:
        """None where it was not measured."""
        if self.value is None:
            return None
        return self.value.median <= self.bound if self.at_most else self.value.median >= self.bound


def results(
    rows: Sequence[Row], times: np.ndarray, differences: Sequence[float | None], standard: float, reference: int = 0
) -> list[Result]:
    """Results of rows from their times (rounds, rows) [s] a call.

    standard : simulated seconds [s] that all times are scaled to; reference : the row of ratio 1.
    """
    scaled = times * (standard / np.array([row.seconds for row in rows]))
    return [
        Result(
            row.label,
            row.ours,
            Spread.of(scaled[:, k]),
            Spread.of(scaled[:, k] / scaled[:, reference]),
            differences[k],
            row.tolerance,
            row.note,
        )
        for k, row in enumerate(rows)
    ]


def number(value: float, digits: int = 3) -> str:
    """`value` with so many significant digits and no exponent."""
    if value == 0.0 or not np.isfinite(value):
        return f"{value:g}"
    places = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{places}f}"


def columns(table: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> list[str]:
    """Lines of a table whose first row is its head; columns in `left` are flush left."""
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = [
        "  ".join(
            cell.ljust(width) if k in left else cell.rjust(width) for k, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in table
    ]
    lines.insert(1, "-" * max(map(len, lines)))
    return lines


def table_text(found: Sequence[Result], standard: float) -> str:
    """The table of all rows, with numbered notes below it."""
    notes: list[str] = []
    table = [("", f"{standard:g} s take [ms]", "quartiles", "ratio", "quartiles", "arm [rad]", "note")]
    for result in found:
        marks = []
        for note in filter(None, (result.note, "" if result.same_arm else _other_arm(result))):
            if note not in notes:
                notes.append(note)
            marks.append(str(notes.index(note) + 1))
        ms = 1e3 * np.array([result.time.median, result.time.low, result.time.high])
        ratio = result.ratio
        table.append(
            (
                result.label,
                number(ms[0]),
                f"{number(ms[1])}..{number(ms[2])}",
                number(ratio.median),
                f"{number(ratio.low)}..{number(ratio.high)}",
                "" if result.difference is None else f"{result.difference:.0e}",
                " ".join(marks),
            )
        )
    lines = columns(table, left=(0, 6))
    lines += [f"  {k}  {note}" for k, note in enumerate(notes, start=1)]
    return "\n".join(lines)


def _other_arm(result: Result) -> str:
    return f"NOT THE SAME ARM: it may end at most {result.tolerance:.0e} rad from ours"


def same_arm_text(found: Sequence[Result]) -> str:
    """One line: how far the arms of the other rows are from ours."""
    compared = [result for result in found if result.difference is not None]
    if not compared:
        return "same arm: nothing to compare"
    worst = max(compared, key=lambda result: result.difference)
    others = [result for result in compared if not result.same_arm]
    text = (
        f"same arm: worst difference {worst.difference:.1e} rad at the end ({worst.label}), "
        f"within its tolerance of {worst.tolerance:.0e} rad"
    )
    if others:
        text = f"NOT THE SAME ARM: {', '.join(result.label for result in others)}"
    return text


def targets_text(targets: Sequence[Target]) -> str:
    """The targets beside what was measured."""
    table = [("target", "aim", "measured", "quartiles", "")]
    for target in targets:
        aim = f"{'<=' if target.at_most else '>='} {target.bound:g}{target.unit}"
        if target.value is None:
            table.append((target.what, aim, "-", "", "not measured"))
            continue
        value = target.value
        table.append(
            (
                target.what,
                aim,
                number(value.median) + target.unit,
                f"{number(value.low)}..{number(value.high)}",
                "reached" if target.reached else "not reached",
            )
        )
    return "\n".join(columns(table, left=(0, 4)))


def as_json(found: Sequence[Result], targets: Sequence[Target], missing: dict[str, str], conditions: dict) -> dict:
    """All of it as plain values; times in seconds."""
    return {
        "conditions": conditions,
        "rows": [{**asdict(result), "same_arm": result.same_arm} for result in found],
        "targets": [{**asdict(target), "reached": target.reached} for target in targets],
        "not_measured": missing,
    }
