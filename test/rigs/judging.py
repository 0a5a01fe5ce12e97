# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An answer beside the expected one, and beside that of changed logs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from puma_sim_core.effects import KINDS
from rigs.catalogue import Expected, Size
from rigs.variants import VARIANTS

RIGHT, WRONG, CANNOT_TELL, ERROR = "right", "wrong", "cannot tell", "error"
#: room for rounding in comparisons with intervals
_ROUNDING = 1e-9


def token(name: str, joint: int | None) -> str:
    """NAME@JOINT, or NAME for the whole machine."""
    return name if joint is None else f"{name}@{joint}"


def _first(name: str) -> str:
    """A token with the name of the first of several of a kind on one joint: no expectation says which of them it is."""
    effect, at, joint = name.partition("@")
    return (KINDS[effect].first if effect in KINDS else effect) + at + joint


def named(report: Mapping[str, Any]) -> list[str]:
    """The effects that a report names, the strongest first."""
    return [token(effect["name"], effect["joint"]) for effect in report["effects"]]


def said(report: Mapping[str, Any]) -> list[str]:
    """The effects, and what has no name, as `rigs.yaml` writes them."""
    shape = report["shape"]
    return named(report) + ([] if shape is None else [f"shape:{shape['axis']}@{shape['joint']}"])


def tied(report: Mapping[str, Any]) -> list[str]:
    """What a report says that it cannot tell from the effects that it names."""
    return [token(tie["name"], tie["joint"]) for effect in report["effects"] for tie in effect["tied_with"]]


def judge(report: Mapping[str, Any] | None, expected: Expected) -> dict[str, Any]:
    """What an answer is worth.

    mark : "right": verdict and names are right, nothing wrong is named, and of no published size the estimate and its
    interval are both off. "cannot tell": as right, but a name that is wanted is only tied with one that is given.
    "wrong": all else; "error" without a report. why : reasons, one phrase each. sizes : see `sizes`.
    """
    if report is None:
        return {"mark": ERROR, "why": [], "sizes": []}
    names, ties, why, open_ = list(map(_first, said(report))), list(map(_first, tied(report))), [], []
    if report["verdict"] not in expected.verdicts:
        why.append(f"verdict {report['verdict']}")
    refused = {fault["channel"] for fault in report.get("faults", ())}
    if expected.faults and refused and refused != set(expected.faults):
        why.append(f"refused for {', '.join(sorted(refused))}")
    for alternatives in expected.names:
        if not set(alternatives) & set(names):
            found = [name for name in alternatives if name in ties]
            if found:
                open_.append(f"{found[0]} only tied")
            else:
                why.append(f"no {alternatives[0]}{' or the like' if len(alternatives) > 1 else ''}")
    wanted = {name for alternatives in expected.names for name in alternatives}
    for name in dict.fromkeys(map(_first, named(report))):
        unlisted = expected.others_wrong and name not in wanted and name not in expected.beside
        # what stands in for a tied name is no wrong name
        stands_in = open_ and name in _with_ties(report, wanted)
        if (name in expected.wrong or unlisted) and not stands_in:
            why.append(f"{name} is wrong")
    compared = sizes(report, expected.sizes)
    why += [f"{each['of']} is off" for each in compared if not each["agrees"]]
    mark = WRONG if why else CANNOT_TELL if open_ else RIGHT
    return {"mark": mark, "why": [*why, *open_], "sizes": compared}


def _with_ties(report: Mapping[str, Any], wanted: Iterable[str]) -> set[str]:
    """The named effects that are tied with one that is wanted."""
    wanted = set(wanted)
    return {
        _first(token(effect["name"], effect["joint"]))
        for effect in report["effects"]
        if wanted & {_first(token(tie["name"], tie["joint"])) for tie in effect["tied_with"]}
    }


def sizes(report: Mapping[str, Any], published: Iterable[Size]) -> list[dict[str, Any]]:
    """The published sizes of what is named: of, value, ci95, unit, published, agrees."""
    found = []
    for size in published:
        name, _, parameter = size.of.rpartition(".")
        own = [e for e in report["effects"] if _first(token(e["name"], e["joint"])) == name]
        rows = [e for e in own if parameter in e["parameters"]]
        if not rows:
            continue
        of_each = [row["parameters"][parameter] for row in rows]
        agreeing = [each for each in of_each if _agrees(each, size.intervals)]
        shown = (agreeing or of_each)[0]
        found.append(
            {
                "of": size.of,
                "value": shown["value"],
                "ci95": shown["ci95"],
                "unit": shown["unit"],
                "published": size.text,
                "agrees": bool(agreeing),
            }
        )
    return found


def _agrees(estimate: Mapping[str, Any], intervals: Iterable[tuple[float, float]]) -> bool:
    """Whether an estimate, or its interval, meets one of some intervals."""
    low, high = _bounds(estimate["ci95"])
    value = estimate["value"]
    return any(least <= value <= most or (low <= most and least <= high) for least, most in intervals)


def _bounds(ci95: Iterable[float | None]) -> tuple[float, float]:
    low, high = ci95
    return -math.inf if low is None else low, math.inf if high is None else high


def flipped(base: Mapping[str, Any], other: Mapping[str, Any], variant: str) -> list[str]:
    """In what the answer to changed logs differs from the one to the logs as they are: nothing, or phrases.

    base, other : outcomes. Sizes are compared with the intervals of the base where both name the effect.
    """
    if other["report"] is None:
        return ["error"] if base["report"] is not None else []
    if base["report"] is None:
        return ["no error"]
    one, two = base["report"], other["report"]
    found = []
    if one["verdict"] != two["verdict"]:
        found.append(f"{one['verdict']} became {two['verdict']}")
    lost, gained = set(named(one)) - set(named(two)), set(named(two)) - set(named(one))
    found += [f"lost {name}" for name in sorted(lost)] + [f"gained {name}" for name in sorted(gained)]
    back = VARIANTS[variant].back
    theirs = {token(e["name"], e["joint"]): e for e in two["effects"]}
    for effect in one["effects"]:
        name = token(effect["name"], effect["joint"])
        if name not in theirs:
            continue
        parameters = theirs[name]["parameters"]
        units = {key: entry["unit"] for key, entry in parameters.items()}
        values = back(effect["name"], {key: (entry["value"],) for key, entry in parameters.items()}, units)
        for key, (value,) in sorted(values.items()):
            low, high = _bounds(effect["parameters"][key]["ci95"])
            room = _ROUNDING * max(abs(value), abs(effect["parameters"][key]["value"]))
            if not low - room <= value <= high + room:
                found.append(f"{name}.{key} {effect['parameters'][key]['value']:.3g} became {value:.3g}")
    return found
