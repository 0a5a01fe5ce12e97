# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The page that a person reads; markup and sentences stand in `templates`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from puma_sim_core.appraisal.measures import MEASURES
from puma_sim_core.appraisal.report import figures
from puma_sim_core.appraisal.report.table import Table
from puma_sim_core.appraisal.report.words import words
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.pages.page import environment, render
from puma_sim_core.pages.text import fixed, listed, number, quantity, scale, unit_text

#: failed trials that the page lists for a controller; all stand in report.json
LISTED = 12
#: what the table of repetitions has, and what the draws are of
_REPEATED, _DRAWS = ("pose_repeatability", "distance_repeatability", "path_repeatability",
                     "path_speed_repeatability"), "noise"  # fmt: skip
#: measures of the heat map
_GROWN = ("greatest_error", "iae", "pose_accuracy", "stabilisation_time", "settling_time", "voltage_rms",
          "voltage_variation", "energy", "current_rms", "saturated_share")  # fmt: skip


def _short(value: float | None, digits: int = 3) -> str:
    """A number with few digits; infinity for None."""
    return "\N{INFINITY}" if value is None else number(value, digits)


def _interval(found: Mapping[str, float], digits: int = 2) -> str:
    value, low, high = (fixed(found[key], digits) for key in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def _in_its_unit(values: Sequence[float | None], limit: float, unit: str) -> tuple[str, list[str]]:
    """A limit with its unit, and values in the same unit, 0 for what is below a ten-thousandth of it."""
    factor, shown = scale([limit], unit)
    texts = [_short(value if value is None else value * factor if value > 1e-4 * limit else 0.0) for value in values]
    return f"{number(limit * factor)} {unit_text(shown)}".rstrip(), texts


def _delicate(found: Mapping[str, Any], controller: str, most: int = 3) -> str:
    """The effects that break a controller first, with their critical sizes."""
    own = [each for each in found["critical_sizes"] if each["controller"] == controller and each["size"] is not None]
    own.sort(key=lambda each: (each["size"], each["effect"]))
    return ", ".join(f"{words(each['effect'])} from {quantity(each['value'], each['unit'])} on" for each in own[:most])


def _changed(each: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """(unit, on the nominal model, on the augmented one, change with its interval) of a measure as text."""
    change = each["change"]
    both = [each["nominal"], each["augmented"]]
    factor, shown = scale([value for value in both if value is not None], each["unit"])
    nominal, augmented = (_short(value if value is None else value * factor) for value in both)
    values = [] if change is None else [number(change[key] * factor, 2) for key in ("value", "low", "high")]
    return unit_text(shown), nominal, augmented, f"{values[0]} ({values[1]} to {values[2]})" if values else "not finite"


def _misled(found: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """The measure that the nominal model misleads about most, beside its limit, as text; "" without any."""
    limits = {(task["name"], each["measure"]): each["value"] for task in found["tasks"] for each in task["limits"]}
    known = [each for each in row["measures"] if each["change"] is not None]
    if not known:
        return ""
    most = max(known, key=lambda each: abs(each["change"]["value"]) / limits[each["task"], each["measure"]])
    nominal, augmented = (quantity(most[model], most["unit"]) for model in ("nominal", "augmented"))
    return f"{words(most['task'])}, {words(most['measure'])}: {nominal} becomes {augmented}"


def _heat(value: float | None) -> int:
    """Class of a growth: 0 below 1.1 times, then one up at 1.5, 3, 10 times and infinity."""
    return 5 if value is None else sum(value >= bound for bound in (1.1, 1.5, 3.0, 10.0))


_PAGES = environment(
    "puma_sim_core.appraisal.report",
    draw=figures,
    short=_short,
    interval=_interval,
    heat=_heat,
    unit=unit_text,
    measures=MEASURES,
    listed=LISTED,
    grown=_GROWN,
    words=words,
    in_its_unit=_in_its_unit,
    delicate=_delicate,
    changed=_changed,
    misled=_misled,
)


def page(table: Table, found: Mapping[str, Any], drawn: Mapping[str, Mapping[str, Response]]) -> str:
    """The whole page; the same battery gives the same text.

    drawn : nominal responses by task and controller, of the tasks of `figures`.
    """
    values = {"board": _board(found), "answer": _answer(found), "lead": _lead(found), "repeated": _repeated(found)}
    return render(_PAGES, "appraisal.html", table=table, r=found, drawn=drawn, **values)


def _repeated(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of repetitions: a task and a measure with its unit, and texts, one a controller."""
    rows = []
    here = [each for each in found["repeats"] if each["perturbation"] == _DRAWS]
    for task in dict.fromkeys(each["task"] for each in here):
        own = [each["measures"] for each in here if each["task"] == task]
        for measure in (name for name in _REPEATED if name in own[0]):
            values = [measures[measure] for measures in own]
            factor, unit = scale([value for value in values if value is not None], MEASURES[measure].unit)
            texts = [_short(value if value is None else value * factor) for value in values]
            rows.append({"task": task, "measure": measure, "unit": unit_text(unit), "texts": texts})
    return rows


def _board(found: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Controllers by rank, those of one rank by score."""
    return sorted(found["scoreboard"], key=lambda row: (row["rank"], -row["score"]["value"]))


def _lead(found: Mapping[str, Any]) -> str:
    """By how much the first controller is ahead of the next one, in a sentence; "" where there is none."""
    names = [row["controller"] for row in _board(found)[:2]]
    for each in found["comparisons"]:
        if {each["first"], each["second"]} == set(names):
            sign = 1.0 if each["first"] == names[0] else -1.0
            apart = each["difference"]
            value, *ends = (fixed(sign * apart[key], 3) for key in ("value", "low", "high"))
            low, high = ends if sign > 0.0 else ends[::-1]
            return f"Its lead on {names[1]}: {value} ({low} to {high})" + (", a tie." if each["tie"] else ".")
    return ""


def _answer(found: Mapping[str, Any]) -> str:
    """Which controller, in a sentence."""
    board = _board(found)
    best = [row["controller"] for row in board if row["rank"] == board[0]["rank"]]
    if len(board) == 1:
        row = board[0]
        return f"{row['controller']} passes {row['passed']} of {row['trials']} trials"
    if len(best) > 1:
        return f"{listed(best)} are tied for the first place"
    return f"{best[0]} is ahead of the other {len(board) - 1}" if len(board) > 2 else f"{best[0]} is ahead"
