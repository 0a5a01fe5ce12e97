# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What was said against what was true: pure functions of a report and an answer.

A report is the mapping of `report.json`, an answer an entry of `answers.json`; the outcome of
one record, as `jobs.work` gives it, becomes a row of plain values.
"""

from __future__ import annotations

import math
import re

#: sizes below say nothing: too little of the effect is left when the parameters are retuned
LEAST_SIZE = 0.6
#: rows that the place of a fault may be off by: what stands still is seen when it should move
ROW_TOLERANCE = 5
ABSTAINED = ("UNNAMED", "NAMED_WITH_REMAINDER")
#: parameters that come round again, and after how much
_PERIODIC = {
    ("torque_ripple", "phase"),
    ("sensor_nonlinearity", "phase"),
    ("transmission_error", "phase"),
    ("position_dependent_friction", "angle"),
}
#: beyond this share an error counts as worse
_WORSE = 1e-6


def truth_of(answer: dict) -> list[tuple]:
    """(name, joint) of the effects that were there."""
    return [(effect["name"], effect["joint"]) for effect in answer["effects"]]


def kind_of(answer: dict) -> str:
    """ "nothing", "single", "pair", "outside" or "fault"."""
    if answer["faults"]:
        return "fault"
    if answer["outside"]:
        return "outside"
    return ("nothing", "single", "pair")[min(len(answer["effects"]), 2)]


def said_of(report: dict) -> list[tuple]:
    """(name, joint) of the effects that were named, in the order of the report."""
    return [(effect["name"], effect["joint"]) for effect in report["effects"]]


def tie_aware(report: dict, truth: list[tuple]) -> bool:
    """Whether each effect that was there is named or said to be tied with a named one."""
    known = set(said_of(report))
    for effect in report["effects"]:
        known |= {(tie["name"], tie["joint"]) for tie in effect["tied_with"]}
    return bool(truth) and set(truth) <= known


def axis_right(shape: dict | None, outside: dict) -> bool:
    """Whether the shape is over the axis of what is outside the library, or one that shows it as
    well. What no axis of the report shows asks for none."""
    wanted = {outside["axis"], *outside["also"]} - {None}
    return shape is not None and (not wanted or shape["axis"] in wanted)


def fault_right(outcome: dict, faults: list[dict]) -> tuple[bool, bool, bool]:
    """(verdict, channel, row) of faulty data: refused, or read without the rows that are wrong.

    A fault that is no one's channel may be said of any. A file that is no table of numbers may be
    refused with an error, which then names column and line.
    """
    channels = {fault["channel"] for fault in faults}
    row = faults[0]["row"]
    if outcome.get("error") is not None:
        text = outcome["error"]
        lines = [int(n) for n in re.findall(r"(?:line|row) (\d+)", text)]
        cut = any("ends inside" in fault["what"] for fault in faults)
        named = channels == {None} or cut or any(channel in text for channel in channels if channel)
        return True, named, row is None or row in lines or row + 1 in lines
    refused = outcome["report"]["verdict"] == "DATA_FAULT"
    found = outcome["report"]["faults" if refused else "cuts"]
    if not found:
        return False, False, False
    if channels == {None}:
        return True, True, True
    matching = [fault for fault in found if fault["channel"] in channels]
    near = any(
        fault["row"] is None if row is None else fault["row"] is not None and abs(fault["row"] - row) <= ROW_TOLERANCE
        for fault in matching
    )
    return True, bool(matching), near


def coverage(report: dict, answer: dict) -> list[tuple[str, bool]]:
    """(effect.parameter, whether its interval holds the true value) of each right name; what was
    not fitted has no interval."""
    true = {(effect["name"], effect["joint"]): effect["parameters"] for effect in answer["effects"]}
    found = []
    for effect in report["effects"]:
        name = effect["name"]
        values = true.get((name, effect["joint"]), {})
        for parameter, value in values.items():
            low, high = effect["parameters"].get(parameter, {}).get("ci95", (0.0, 0.0))
            if low is None or high is None or not low < high:
                continue
            if (name, parameter) in _PERIODIC:
                value += 2.0 * math.pi * math.ceil((low - value) / (2.0 * math.pi))
            found.append((f"{name}.{parameter}", bool(low <= value <= high)))
    return found


def over_joints(values) -> float | None:
    """Root mean square over the joints of errors [rad]; None where one is missing."""
    if values is None or any(value is None or not math.isfinite(value) for value in values):
        return None
    return math.sqrt(sum(value**2 for value in values) / len(values))


def held_out(report: dict, stage: str, part: str = "held_out") -> float | None:
    """Open-loop position error [rad] of a stage on a part of what was kept back."""
    errors = report["errors"][part]
    return None if errors is None else over_joints(errors["position_rms"][stage])


def row_of(outcome: dict) -> dict:
    """One record scored; values that do not apply are None."""
    answer, report = outcome["answer"], outcome.get("report")
    kind, truth = kind_of(answer), truth_of(answer)
    sizes = [effect["size"] for effect in answer["effects"]]
    row = {
        "record": outcome["record"],
        "kind": kind,
        "case": answer["recipe"].get("case"),
        "truth": truth,
        "size": min(sizes) if sizes else answer["size"],
        "distinct_size": min((effect["distinct_size"] for effect in answer["effects"]), default=None),
        "what": answer["outside"]["what"]
        if kind == "outside"
        else answer["recipe"]["fault"]
        if kind == "fault"
        else "+".join(name for name, _ in truth) or "nothing",
        "verdict": report["verdict"] if report else "ERROR",
        "error": outcome.get("error"),
        "seconds": outcome.get("seconds"),
        "megabytes": outcome.get("megabytes"),
        "said": said_of(report) if report else [],
        "baselines": {},
    }
    if kind == "fault":
        row["fault"] = fault_right(outcome, answer["faults"])
        return row
    if report is None:
        report = {"verdict": "ERROR", "effects": [], "shape": None, "errors": {"held_out": None, "unseen": None}}
    said = row["said"]
    row["named"] = bool(said)
    if kind == "nothing":
        row["alarm"] = row["verdict"] != "NOTHING_MISSING"
        row["false_name"] = bool(said)
    if kind in ("single", "pair"):
        row["top1"] = bool(said) and said[0][0] in {name for name, _ in truth}
        row["joint_right"] = bool(said) and said[0][1] in {joint for _, joint in truth}
        row["exact"] = bool(said) and said[0] in truth
        row["tie_aware"] = tie_aware(report, truth)
        row["needless"] = len(said) > len(truth)
        row["coverage"] = coverage(report, answer)
    if kind == "pair":
        row["both"] = set(truth) <= set(said)
        row["one"] = bool(set(truth) & set(said))
    if kind == "outside":
        shape = report["shape"]
        row["abstained"] = row["verdict"] in ABSTAINED
        row["axis_right"] = axis_right(shape, answer["outside"])
        row["shape_joint"] = shape is not None and shape["joint"] == answer["outside"]["joint"]
        row["shape"] = None if shape is None else [shape["axis"], shape["joint"]]
    _errors(row, outcome, report, truth)
    return row


def _errors(row: dict, outcome: dict, report: dict, truth: list[tuple]) -> None:
    """Held-out errors over that of the true structure, ours and the baselines'."""
    ours, retuned = held_out(report, "augmented"), held_out(report, "retuned")
    reached = outcome.get("true_structure") or {}
    true, unseen = (over_joints(reached.get(rows)) for rows in ("held_out", "unseen"))
    if row["kind"] == "nothing":
        true = retuned  # nothing is the true structure
    row["ratio"] = _ratio(ours, true)
    row["against_retuned"] = _ratio(ours, retuned) if row["named"] else None
    row["worse"] = _worse(row["against_retuned"])
    # the quarter that no choice has seen holds a few windows, and tells of luck as well
    before = held_out(report, "retuned", "unseen")
    row["unseen_worse"] = _worse(_ratio(held_out(report, "augmented", "unseen"), before) if row["named"] else None)
    row["only_here"] = bool(row["unseen_worse"]) and not _worse(_ratio(unseen, before))
    for name, made in (outcome.get("baselines") or {}).items():
        names = [tuple(each) for each in made["names"]]
        row["baselines"][name] = {
            "top1": bool(names) and names[0][0] in {n for n, _ in truth},
            "joint_right": bool(names) and names[0][1] in {j for _, j in truth},
            "alarm": bool(names),
            "needless": len(names) > len(truth),
            "both": bool(truth) and set(truth) <= set(names),
            "named": bool(names),
            "ratio": _ratio(over_joints(made["position_rms"]), unseen, math.inf if made["names"] else None),
        }
    row["baselines"]["retuning"] = {
        "top1": False,
        "joint_right": False,
        "alarm": False,
        "needless": False,
        "both": False,
        "named": False,
        "ratio": _ratio(retuned, true),
    }


def _worse(ratio: float | None) -> bool | None:
    return None if ratio is None else ratio > 1.0 + _WORSE


def _ratio(one: float | None, other: float | None, without: float | None = None) -> float | None:
    """One error over another; `without` where a model could not even be run."""
    if not other:
        return None
    return without if one is None else one / other
