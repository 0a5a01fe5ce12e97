# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The table of the bench: rows of plain values, and these as JSON, as a page, and as Markdown."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from puma_sim_core import __version__
from puma_sim_core.pages.page import environment, render
from rigs.catalogue import Rig, Run
from rigs.judging import CANNOT_TELL, ERROR, RIGHT, WRONG, flipped, judge, named, tied
from rigs.variants import VARIANTS

STAGES = ("nominal", "retuned", "augmented", "floor")
NOT_MEASURED, NOT_DESCRIBED = "not measured yet", "cannot be described yet"
MARKS = (RIGHT, WRONG, CANNOT_TELL, ERROR, NOT_MEASURED, NOT_DESCRIBED)


def row_of(rig: Rig, run: Run, outcome: Mapping[str, Any] | None, variants: Mapping[str, Mapping]) -> dict[str, Any]:
    """A row of the table.

    outcome : of the run, None where there is none yet; variants : outcomes of its variants by name.
    """
    row: dict[str, Any] = {
        "rig": rig.name,
        "run": run.name,
        "key": run.key,
        "role": run.role,
        "split": run.split,
        "logs": [log.label for log in run.logs],
        "held_out": [log.label for log in run.held_out],
        "mechanism": rig.mechanism,
        "expected": run.expected.text,
        "verdicts": list(run.expected.verdicts),
        "sure": list(run.expected.sure),
        "note": run.expected.note,
        "reference": None,
        "needs": run.needs,
        "mark": NOT_DESCRIBED if run.needs else NOT_MEASURED,
        "why": [],
        "given": None,
        "sizes": [],
        "errors": None,
        "flips": None,
        "seconds": None,
        "megabytes": None,
        "report": None,
    }
    if run.reference is not None:
        r = run.reference
        row["reference"] = {"value": r.value, "unit": r.unit, "measure": r.measure, "source": r.source, "ours": None}
    if outcome is None or run.needs:
        return row
    report = outcome["report"]
    row |= judge(report, run.expected)
    row |= {"seconds": outcome["seconds"], "megabytes": outcome["megabytes"]}
    if report is None:
        return {**row, "why": [outcome["error"]]}
    row |= {
        "given": {
            "verdict": report["verdict"],
            "names": named(report),
            "tied": tied(report),
            "shape": report["shape"],
            "sentence": report["sentence"],
            "effects": report["effects"],
        },
        "errors": _errors(report),
        "flips": _flips(outcome, variants),
        "report": f"{run.key}/report.html",
    }
    if row["reference"] is not None:
        row["reference"]["ours"] = outcome["ours"]
    return row


def _errors(report: Mapping[str, Any]) -> dict[str, Any] | None:
    """Of the validation set, each stage over all joints: voltage, and position in open-loop windows."""
    held = report["errors"]["held_out"]
    if held is None:
        return None
    found = {quantity: {stage: _over_joints(held[quantity][stage]) for stage in STAGES} for quantity in held}
    return {**found, "voltage_unit": report["voltage_unit"], "position_unit": report["position_unit"]}


def _over_joints(values: Iterable[float | None]) -> float | None:
    """Root of the mean square, None where one is missing."""
    values = list(values)
    return None if None in values else math.sqrt(sum(v * v for v in values) / len(values))


def _flips(outcome: Mapping[str, Any], variants: Mapping[str, Mapping]) -> dict[str, Any] | None:
    """applied : variants that were explained; flips : variant -> in what the answer differs."""
    applied = [name for name in VARIANTS if name in variants and variants[name]["applies"]]
    if not applied:
        return None
    different = {name: flipped(outcome, variants[name], name) for name in applied}
    return {"applied": applied, "flips": {name: phrases for name, phrases in different.items() if phrases}}


def summary(rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    """Counts of marks by role."""
    found: dict[str, Counter] = {}
    for row in rows:
        found.setdefault(row["role"], Counter())[row["mark"]] += 1
    return {role: {mark: counts[mark] for mark in MARKS if counts[mark]} for role, counts in sorted(found.items())}


def json_of(rows: list[dict[str, Any]], code: str) -> str:
    """The text of rigs.json."""
    whole = {"version": __version__, "code": code, "summary": summary(rows), "rows": rows}
    return json.dumps(whole, indent=1, allow_nan=False) + "\n"


# ------------------------------------------------------------------------------------------------------ texts of cells


def number(value: float | None) -> str:
    """Three digits; - where there is none."""
    return "-" if value is None else f"{value:.3g}"


def answer_text(row: Mapping[str, Any]) -> str:
    """The given answer in one line."""
    given = row["given"]
    if given is None:
        return "-"
    names = ", ".join(given["names"])
    ties = f" (tied with {', '.join(given['tied'])})" if given["tied"] else ""
    shape = given["shape"]
    rest = "" if shape is None else f"; left: over {shape['axis']}@{shape['joint']}"
    return f"{given['verdict']}{': ' if names else ''}{names}{ties}{rest}"


def mark_text(row: Mapping[str, Any]) -> str:
    """The mark with its reasons."""
    if row["needs"]:
        return f"{NOT_DESCRIBED}: needs {row['needs']}"
    return row["mark"] + (f": {'; '.join(row['why'])}" if row["why"] else "")


def size_texts(row: Mapping[str, Any]) -> list[str]:
    """Sizes with their intervals: those that are published beside them, then the other ones."""
    published = {size["of"] for size in row["sizes"]}
    texts = [
        f"{size['of']} {_estimate(size)}, published {size['published']}{'' if size['agrees'] else ' (off)'}"
        for size in row["sizes"]
    ]
    for effect in row["given"]["effects"] if row["given"] else ():
        name = effect["name"] if effect["joint"] is None else f"{effect['name']}@{effect['joint']}"
        texts += [
            f"{name}.{key} {_estimate(entry)}"
            for key, entry in effect["parameters"].items()
            if f"{name}.{key}" not in published
        ]
    return texts


def _estimate(entry: Mapping[str, Any]) -> str:
    low, high = (number(end) for end in entry["ci95"])
    unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
    return f"{number(entry['value'])} ({low} to {high}){unit}"


def error_text(row: Mapping[str, Any], quantity: str) -> str:
    """Nominal / retuned / augmented / floor of a quantity."""
    if row["errors"] is None:
        return "-"
    unit = row["errors"]["position_unit" if quantity == "position_rms" else "voltage_unit"]
    return " / ".join(number(row["errors"][quantity][stage]) for stage in STAGES) + f" {unit}"


def reference_text(row: Mapping[str, Any]) -> str:
    """The best published or reference error, and ours in the same measure."""
    reference = row["reference"]
    if reference is None:
        return "-"
    ours = "" if reference["ours"] is None else f"; here {number(reference['ours'])}"
    return f"{number(reference['value'])} {reference['unit']}{ours} ({reference['measure']}; {reference['source']})"


def flip_text(row: Mapping[str, Any]) -> str:
    """How many variants changed the answer, and how."""
    if row["flips"] is None:
        return "-"
    applied, flips = row["flips"]["applied"], row["flips"]["flips"]
    which = "; ".join(f"{name}: {', '.join(phrases)}" for name, phrases in flips.items())
    return f"{len(flips)} of {len(applied)}" + (f" ({which})" if which else "")


def line(row: Mapping[str, Any]) -> str:
    """One line for the terminal."""
    return f"{row['key']}: {answer_text(row)} -> {mark_text(row)} ({number(row['seconds'])} s)"


# --------------------------------------------------------------------------------------------------------------- pages


def page_of(rigs: list[Rig], rows: list[dict[str, Any]], code: str) -> str:
    """The text of rigs.html."""
    texts = (answer_text, mark_text, size_texts, error_text, reference_text, flip_text, number)
    pages = environment("rigs", **{function.__name__: function for function in texts})
    by_rig = [(rig, [row for row in rows if row["rig"] == rig.name]) for rig in rigs]
    return render(pages, "rigs.html", rigs=by_rig, summary=summary(rows), code=code)


def markdown_of(rigs: list[Rig], rows: list[dict[str, Any]]) -> str:
    """The tables of all machines for the documentation."""
    out = ["| role | " + " | ".join(MARKS) + " |", "|---|" + "---|" * len(MARKS)]
    for role, counts in summary(rows).items():
        out.append(f"| {role} | " + " | ".join(str(counts.get(mark, 0)) for mark in MARKS) + " |")
    for rig in rigs:
        own = [row for row in rows if row["rig"] == rig.name]
        if own:
            out += ["", f"### {rig.title} (`{rig.name}`)", "", f"Source: {rig.source}."]
            out += _logs_of(rig) + _answers(own) + _figures(own)
    return "\n".join(out) + "\n"


def _logs_of(rig: Rig) -> list[str]:
    def listed(names: Iterable[str]) -> str:
        names = [name.removesuffix(".gz").removesuffix(".csv") for name in names]
        return ", ".join(names) if len(names) < 20 else f"all {len(names)}"

    out = ["", f"Development logs: {listed(rig.development_logs)}. Test logs: {listed(rig.test_logs) or 'none'}."]
    return [*out, "", f"Cannot be described yet: needs {rig.needs}."] if rig.needs else out


def _answers(rows: list[dict[str, Any]]) -> list[str]:
    out = ["", "| run | split | role | expected (how sure) | given | |", "|---|---|---|---|---|---|"]
    for row in rows:
        mark = NOT_DESCRIBED if row["needs"] else mark_text(row)
        cells = (row["run"], row["split"], row["role"], f"{row['expected']} ({', '.join(row['sure'])})")
        out.append(_markdown_row(*cells, answer_text(row), mark))
    return out


def _figures(rows: list[dict[str, Any]]) -> list[str]:
    """Sizes, errors, references, flips, seconds and memory of the runs that have an answer, or a reference."""
    shown = [row for row in rows if row["given"] is not None or row["reference"] is not None]
    if not shown:
        return []
    head = (
        "| run | sizes (95 %) | voltage, nominal / retuned / augmented / floor | position in open-loop windows, same | "
    )
    head += "best published or reference error | flips | s | MB |"
    out = ["", head, "|---|---|---|---|---|---|---|---|"]
    for row in shown:
        cells = ("; ".join(size_texts(row)) or "-", error_text(row, "voltage_rms"), error_text(row, "position_rms"))
        cells += (reference_text(row), flip_text(row), number(row["seconds"]), number(row["megabytes"]))
        out.append(_markdown_row(row["run"], *cells))
    return out


def _markdown_row(*cells: str) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"
