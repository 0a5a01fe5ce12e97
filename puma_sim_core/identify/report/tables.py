# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The tables of a report: parameters found, errors, ranking, what could not have been seen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from puma_sim_core.identify.report.text import (
    DASH,
    MINUS,
    SPACE,
    effect_name,
    estimate,
    gain,
    hypothesis,
    listed,
    number,
    place,
    scale,
    text,
    unit,
)
from puma_sim_core.identify.result import (
    Detectable,
    Explanation,
    FeedbackBias,
    Hypothesis,
    NamedEffect,
    Ranked,
    RuledOut,
)

STAGES = ("nominal", "retuned", "augmented", "floor")
#: rows that stand open; the rest of a long table unfolds
_OPEN = 12


def table(
    heads: Sequence[str], rows: Iterable[str], kind: str = "", caption: str = "", values: Iterable[int] = ()
) -> str:
    """A table of finished rows; the columns `values` hold numbers."""
    cells = "".join(f'<th scope="col"{_value_class(i in values)}>{head}</th>' for i, head in enumerate(heads))
    shown = f"<caption>{caption}</caption>\n" if caption else ""
    return (
        f"<table{f' class={chr(34)}{kind}{chr(34)}' if kind else ''}>\n{shown}"
        f"<thead><tr>{cells}</tr></thead>\n<tbody>\n{''.join(rows)}</tbody>\n</table>\n"
    )


def parameters_found(effect: NamedEffect) -> str:
    """Parameters of an effect with their intervals."""
    rows = []
    for name, found in effect.parameters.items():
        value, interval, shown = estimate(found)
        rows.append(
            f'<tr><th scope="row">{text(name.replace("_", " "))}</th>'
            f'<td class="value mean">{value}</td><td class="value">{interval}</td>'
            f"<td>{shown or DASH}</td></tr>\n"
        )
    return table(("Parameter", "Value", f"95{SPACE}% interval", "Unit"), rows, "narrow", values=(1, 2))


def errors(explanation: Explanation, quantity: str, base: str, caption: str) -> str:
    """Errors of one quantity, held-out rows first: a column for each stage, a row for a joint."""
    parts = [
        (words, explanation.errors[part])
        for part, words in (
            ("held_out", "Held-out data, not used to fit"),
            ("unseen", "Of that, what the choice of effects has not seen either"),
            ("fit", "Fitted data"),
        )
        if part in explanation.errors
    ]
    everything = [np.ravel(getattr(getattr(each, quantity), stage)) for _, each in parts for stage in STAGES]
    factor, shown = scale(np.concatenate(everything), base)
    rows = []
    for words, each in parts:
        rows.append(f'<tr><th scope="rowgroup" colspan="5">{words}</th></tr>\n')
        columns = [np.atleast_1d(getattr(getattr(each, quantity), stage)) for stage in STAGES]
        for j in range(max(column.size for column in columns)):
            cells = "".join(
                f'<td class="value{" mean" if stage == "augmented" else ""}">'
                f"{number(column[j] * factor if j < column.size else None)}</td>"
                for stage, column in zip(STAGES, columns)
            )
            rows.append(f'<tr><th scope="row">{place(j + 1)}</th>{cells}</tr>\n')
    return table(
        ("", "nominal", "retuned", "augmented", "noise floor"),
        rows,
        caption=f"{caption} [{unit(shown)}]",
        values=range(1, 5),
    )


def ranking(explanation: Explanation) -> str:
    """All hypotheses, the best first, with the reason for or against each."""
    reasons = {(each.name, each.joint): each.because for effect in explanation.effects for each in effect.ruled_out}
    ranked = list(explanation.ranking)
    present = {(each.name, each.joint) for each in ranked}
    for effect in explanation.effects:
        ranked += [each for each in effect.ruled_out if (each.name, each.joint) not in present]
    largest = max([each.evidence for each in explanation.ranking if math.isfinite(each.evidence)], default=1.0)
    rows = [_ranked(each, reasons, max(largest, 1.0), explanation) for each in ranked]
    return _unfolding(
        ("Effect", "Gain of evidence [nat]", "Why it is named, or why not"), rows, "stack", "further hypotheses"
    )


def _ranked(each: Ranked | RuledOut, reasons: dict, largest: float, explanation: Explanation) -> str:
    key = (each.name, each.joint)
    evidence = getattr(each, "evidence", math.nan)
    verdict = getattr(each, "verdict", "")
    kind, why = "", text(reasons.get(key) or verdict)
    if key in {(e.name, e.joint) for e in explanation.effects}:
        kind, why = ' class="named"', "Named: it explains the residual best."
        if verdict not in ("named", ""):
            why = text(verdict)
    else:
        ties = [e for e in explanation.effects if key in {(t.name, t.joint) for t in e.tied_with}]
        if ties or verdict == "tied":
            kind = ' class="tied"'
            with_what = listed([hypothesis(e, lower=True) for e in ties]) if ties else ""
            why = (
                f"Tied{' with ' + with_what if with_what else ''}: this record cannot tell the two apart."
                if verdict in ("tied", "")
                else text(verdict)
            )
    share = max(0.0, evidence) / largest if math.isfinite(evidence) else 0.0
    bar = f'<div class="gain"><b>{gain(evidence)}</b><i style="width:{100.0 * min(share, 1.0):.1f}%"></i></div>'
    return (
        f'<tr{kind}><th scope="row">{hypothesis(each)}</th><td class="bar">{bar}</td>'
        f"<td>{why[:1].upper() + why[1:] or DASH}</td></tr>\n"
    )


def detectability(found: Sequence[Detectable], joints: int) -> str:
    """Smallest sizes: a row for each effect, a column for each joint."""
    groups: dict[tuple[str, str, str], dict[int | None, Detectable]] = {}
    for each in found:
        groups.setdefault((each.name, each.parameter, each.unit), {})[each.joint] = each
    rows = []
    for (name, parameter, base), cells in groups.items():
        factor, shown = scale([each.size for each in cells.values() if each.excited], base)
        label = (
            f'{effect_name(name)} <span class="soft">({text(parameter.replace("_", " "))}'
            f"{', ' + unit(shown) if unit(shown) else ''})</span>"
        )
        if None in cells:
            inside = (
                f'<td class="value" colspan="{joints}" data-name="whole arm">'
                f'<span class="soft desk">whole arm</span> '
                f"{_smallest(cells[None], factor)}</td>"
            )
        else:
            inside = "".join(
                f'<td class="value" data-name="joint {j}">{_smallest(cells[j], factor) if j in cells else DASH}</td>'
                for j in range(1, joints + 1)
            )
        rows.append(f'<tr><th scope="row">{label}</th>{inside}</tr>\n')
    return table(
        ("Effect (what the size is of, unit)", *(f"joint{SPACE}{j}" for j in range(1, joints + 1))),
        rows,
        "stack across",
        values=range(1, joints + 1),
    )


def _smallest(each: Detectable, factor: float) -> str:
    if not each.excited:
        return '<span class="unseen">not excited</span>'
    return number(each.size * factor, 2)


def parameters_retuned(parameters: dict[str, tuple]) -> str:
    """Start and retuned values, those that moved most on top."""

    def moved(entry):
        start, retuned, _, *width = entry[1]
        step = abs(retuned - start)
        if width and width[0]:
            return step / width[0]
        return step / abs(start) if start else step

    known = any(len(entry) > 3 and entry[3] for entry in parameters.values())
    rows = []
    for name, (start, retuned, base, *width) in sorted(parameters.items(), key=moved, reverse=True):
        relative = f"{(retuned - start) / start:+.1%}".replace("-", MINUS) if start else DASH
        widths = ""
        if known:
            many = (retuned - start) / width[0] if width and width[0] else math.nan
            shown = f"{many:+.2f}".replace("-", MINUS) if math.isfinite(many) else DASH
            far = ' <span class="unseen">far</span>' if abs(many) > 2.5 else ""
            widths = f'<td class="value" data-name="prior widths">{shown}{far}</td>'
        rows.append(
            f'<tr><th scope="row"><code>{text(name)}</code>'
            f"{f' [{unit(base)}]' if unit(base) else ''}</th>"
            f'<td class="value" data-name="start">{number(start, 5)}</td>'
            f'<td class="value" data-name="retuned">{number(retuned, 5)}</td>'
            f'<td class="value" data-name="change">{relative}</td>{widths}</tr>\n'
        )
    heads = ["Parameter", "Start", "Retuned", "Change", *(["In prior widths"] if known else [])]
    return _unfolding(heads, rows, "stack across", "further parameters, which moved less", range(1, 5))


def feedback(found: FeedbackBias) -> str:
    """The test for feedback, joint by joint."""
    statistic, p_value = (np.atleast_1d(np.asarray(each, dtype=float)) for each in (found.statistic, found.p_value))
    rows = [
        f'<tr><th scope="row">{place(j + 1)}</th><td class="value">{number(a)}</td>'
        f'<td class="value">{"&lt; 0.0001" if 0.0 <= b < 1e-4 else number(b, 2)}</td></tr>\n'
        for j, (a, b) in enumerate(zip(statistic, p_value))
    ]
    return table(("", "Statistic", "p-value"), rows, "narrow", values=(1, 2))


def faults(explanation: Explanation) -> str:
    """What is wrong with the data, channel by channel."""
    rows = [
        f'<tr><th scope="row"><code>{text(each.channel)}</code></th>'
        f'<td data-name="first row">{"whole channel" if each.row is None else each.row}</td>'
        f"<td>{text(each.what)}</td></tr>\n"
        for each in explanation.faults
    ]
    return table(("Channel", "First row", "What is wrong"), rows, "stack")


def not_excited(found: Sequence[Detectable]) -> list[str]:
    """Names of the effects with the joints on which the log could not have shown them."""
    groups: dict[str, list[Hypothesis]] = {}
    for each in found:
        if not each.excited:
            groups.setdefault(each.name, []).append(each)
    names = []
    for name, places in groups.items():
        shown = effect_name(name)
        if places[0].joint is not None:
            joints = [str(each.joint) for each in places]
            everywhere = len(joints) == sum(each.name == name for each in found)
            shown += (
                " (all joints)"
                if everywhere and len(joints) > 1
                else f" (joint{'s' * (len(joints) > 1)}{SPACE}{listed(joints)})"
            )
        names.append(shown)
    return names


def _unfolding(heads: Sequence[str], rows: list[str], kind: str, more: str, values: Iterable[int] = ()) -> str:
    open_rows, folded = rows[:_OPEN], rows[_OPEN:]
    shown = table(heads, open_rows, kind, values=values)
    if folded:
        shown += (
            f"<details><summary>{len(folded)} {more}</summary>\n{table(heads, folded, kind, values=values)}</details>\n"
        )
    return shown


def _value_class(is_value: bool) -> str:
    return ' class="value"' if is_value else ""
