# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The report that a person reads: one HTML file that needs no network and has no script.

On top what is missing, how sure that is and how much better the model becomes; below it the
evidence, what the record could not have shown, and what to measure next.
"""

from __future__ import annotations

import math

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.effects import KINDS
from puma_sim_core.identify.report import figures, tables
from puma_sim_core.identify.report.answers import answers, badge
from puma_sim_core.identify.report.drawing import Chart, key_svg, svg
from puma_sim_core.identify.report.style import CSS
from puma_sim_core.identify.report.text import (
    DASH,
    SPACE,
    effect_name,
    gain,
    hypothesis,
    is_augmented,
    listed,
    mechanism,
    place,
    quantity,
    text,
    unit,
)
from puma_sim_core.identify.result import DATA_FAULT, NOTHING_MISSING, Explanation, NamedEffect

_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>{css}</style>
</head>
<body class="{verdict}">
<header id="top">
<p class="from">puma-sim explain {dot} {machine} {dot} {logs}</p>
<span class="badge">{badge}</span>
<h1>{headline}</h1>
{answers}</header>
<nav aria-label="Contents"><ul>
{contents}</ul></nav>
<main>
{sections}</main>
<footer><p>Made by puma-sim {version}, seed {seed}, in {seconds}. The numbers stand in
<code>report.json</code> beside this page{model}.</p></footer>
</body>
</html>
"""
_WORDS = {
    "nominal": "nominal: the model as given",
    "retuned": "retuned: its parameters fitted, nothing added",
    "augmented": "augmented: with what was found added",
    "floor": "noise floor",
}


def page(explanation: Explanation) -> str:
    """The whole page; the same explanation gives the same text."""
    e = explanation
    found = [(anchor, title, content) for anchor, title, content in _sections(e) if content]
    return _PAGE.format(
        policy=_POLICY,
        css=CSS,
        verdict=text(e.verdict),
        dot="\N{MIDDLE DOT}",
        title=f"{badge(e)}: {text(', '.join(map(_base_name, e.logs)) or e.mechanism)}",
        machine=mechanism(e),
        logs=_log_names(e),
        badge=badge(e),
        headline=text(e.sentence),
        answers=answers(e),
        contents="".join(f'<li><a href="#{anchor}">{title}</a></li>\n' for anchor, title, _ in found),
        sections="".join(
            f'<section id="{anchor}">\n<h2>{title}</h2>\n{content}</section>\n' for anchor, title, content in found
        ),
        version=text(e.version or __version__),
        seed=e.seed,
        seconds=quantity(e.seconds, "s") if e.seconds else "no time",
        model="" if e.model is None else ", the model with what was found in it in <code>model.yaml</code>",
    )


def _sections(e: Explanation) -> list[tuple[str, str, str]]:
    """(anchor, title, content) in the order of their weight for this verdict."""
    unseen = ("unseen", "What this record could not have shown", _unseen(e))
    sections = [
        ("faults", "Faults of the data", _faults(e)),
        ("found", "What was found", _found(e)),
        ("shape", "What has no name", _shape(e)),
        ("errors", "How much better", _errors(e)),
        ("residual", "Residual before and after", _residual(e)),
        ("ranking", "Why this, and not another", _ranking(e)),
        ("whiteness", "What is left", _whiteness(e)),
        unseen,
        ("feedback", "Feedback in the recording", _feedback(e)),
        ("next", "What to measure next", _next(e)),
        ("parameters", "Parameters retuned", _parameters(e)),
        ("logs", "Logs and settings", _logs(e)),
    ]
    if e.verdict == NOTHING_MISSING:
        sections.remove(unseen)
        sections.insert(2, unseen)
    return sections


def _found(e: Explanation) -> str:
    parts = []
    if e.verdict == DATA_FAULT:
        parts.append(
            "<p>The data have a fault, so that nothing was sought in them: a name found "
            "in faulty data would be an accident.</p>\n"
        )
    elif e.verdict == NOTHING_MISSING:
        parts.append(
            "<p>No effect of the library explains the residual of the retuned model "
            "better than chance does, and the residual looks like noise. This says "
            "something only of what the record could have shown: see "
            '<a href="#unseen">the smallest sizes that it could</a>.</p>\n'
        )
    elif not e.effects:
        parts.append(
            "<p>The residual is not noise, and no effect of the library explains it. Its shape is below.</p>\n"
        )
    parts += [_effect(effect) for effect in e.effects]
    if e.notes:
        items = "".join(f"<li>{text(note)}</li>\n" for note in e.notes)
        parts.append(f'<h3>Notes</h3>\n<ul class="plain">\n{items}</ul>\n')
    return "".join(parts)


def _effect(effect: NamedEffect) -> str:
    kind = KINDS.get(effect.name)
    parts = [f"<h3>{hypothesis(effect)}</h3>\n"]
    if kind is not None:
        parts.append(f'<p>{text(kind.sentence)} <span class="soft">{text(kind.equation)}</span></p>\n')
    if effect.parameters:
        parts.append(tables.parameters_found(effect))
    parts.append(f"<p>Evidence: {gain(effect.evidence)} nat over the model without it.")
    if effect.tied_with:
        ties = listed([hypothesis(each, lower=True) for each in effect.tied_with])
        parts.append(f" <b>Tied with {ties}</b>: this record cannot tell them apart.")
    if effect.ruled_out:
        names = dict.fromkeys(effect_name(each.name) for each in effect.ruled_out)
        parts.append(f' Ruled out: {listed([_lower(name) for name in names])} (<a href="#ranking">reasons</a>).')
    return "".join(parts) + "</p>\n"


def _faults(e: Explanation) -> str:
    return tables.faults(e) if e.faults else ""


def _shape(e: Explanation) -> str:
    shape = e.shape
    if shape is None:
        return ""
    if shape.line_hz is None:
        parts = [
            f"<p>What is left on {place(shape.joint)} follows the "
            f"<b>{text(shape.axis.replace('_', ' '))}</b> better than any other variable."
            "</p>\n"
        ]
    else:
        parts = [
            f"<p>What is left on {place(shape.joint)} is an oscillation: a line of the "
            f"spectrum at <b>{quantity(shape.line_hz, 'Hz')}</b>, whatever the motion.</p>\n"
        ]
    if shape.ranking:
        named = [f"{text(name.replace('_', ' '))} {gain(evidence)}{SPACE}nat" for name, evidence in shape.ranking[:8]]
        parts.append(f'<p class="soft">Gain of evidence: {", ".join(named)}.</p>\n')
    curve = figures.shape_of_the_unnamed(e)
    clouds = [] if e.effects else figures.residual_against(e)
    keys = []
    if curve is not None:
        keys += [("line", figures.COLOURS["retuned"], "mean"), ("band", figures.COLOURS["retuned"], f"95{SPACE}% band")]
    if clouds:
        keys += [
            ("points", figures.COLOURS[name], f"{name}, dots; mean, line")
            for name in ("retuned", *(["augmented"] if is_augmented(e) else []))
        ]
    if keys:
        parts += [_drawn([*([] if curve is None else [curve]), *clouds], "shape"), _legend(keys)]
    return "".join(parts)


def _errors(e: Explanation) -> str:
    if not e.errors:
        return ""
    words = (
        "The model <b>nominal</b> as given, <b>retuned</b> with its parameters fitted and "
        "nothing added, and <b>augmented</b> with what was found; beside them what noise "
        "alone would leave. Positions are of the model running in open loop from measured "
        "states."
    )
    pairs = (
        ("position_rms", e.position_unit, "Open-loop position error, root mean square"),
        ("voltage_rms", e.voltage_unit, "Residual, measured less predicted, root mean square"),
    )
    shown = "".join(f"<div>{tables.errors(e, *pair)}</div>\n" for pair in pairs)
    part = "held_out" if "held_out" in e.errors else "fit"
    charts = [chart for name, _, _ in pairs if (chart := figures.errors_chart(e, part, name)) is not None]
    drawn = (
        _drawn(charts, "errors", "two")
        + _legend([("marks", colour, _WORDS[name], figures.MARKS[name]) for name, colour in figures.COLOURS.items()])
        if charts
        else ""
    )
    return f'<p>{words}</p>\n{drawn}<div class="errors">\n{shown}</div>\n'


def _residual(e: Explanation) -> str:
    in_time = figures.residual_in_time(e)
    if not in_time:
        return ""
    against = figures.residual_against(e) if e.effects else []
    stages = ("nominal", "retuned", "augmented") if is_augmented(e) else ("nominal", "retuned")
    parts = [
        f"<p>Measured less predicted [{unit(e.voltage_unit)}]. What is explained should "
        "leave a flat band of noise.</p>\n"
    ]
    if against:
        parts += [
            "<h3>Against the variable that matters</h3>\n",
            _drawn(against, "against"),
            _legend(
                [("points", figures.COLOURS[name], f"{name}, dots; mean, line") for name in ("retuned", "augmented")]
            ),
        ]
    shaded = (
        [("spans", figures.HELD_OUT, "kept back from the choice and the final fit")]
        if np.any(np.asarray(e.drawn.held_out) > 0.5)
        else []
    )
    parts += [
        "<h3>In time</h3>\n",
        _drawn(in_time, "time"),
        _legend([*(("line", figures.COLOURS[name], _WORDS[name]) for name in stages), *shaded]),
    ]
    return "".join(parts)


def _ranking(e: Explanation) -> str:
    if not e.ranking and not any(effect.ruled_out for effect in e.effects):
        return ""
    return (
        "<p>Each hypothesis was added alone to the retuned model. Evidence is the gain of the "
        "log marginal likelihood in nat: it rises with the fit and falls with the freedom "
        "that the fit takes. The model as it is has 0.</p>\n"
    ) + tables.ranking(e)


def _whiteness(e: Explanation) -> str:
    charts = figures.whiteness(e)
    if not charts:
        return ""
    model = "augmented" if is_augmented(e) else "retuned"
    return (
        f"<p>Autocorrelation of the residual of the {model} model, after the colour that the "
        "noise itself has is taken out. Where nothing is left to find, nearly all lags stay "
        f"in the band.</p>\n{_drawn(charts, 'white')}"
    )


def _unseen(e: Explanation) -> str:
    if not e.detectability:
        return ""
    joints = max(
        [each.joint or 1 for each in e.detectability]
        + [np.size(errors.position_rms.nominal) for errors in e.errors.values()]
    )
    missing = tables.not_excited(e.detectability)
    words = (
        "The motion of this record could have shown every effect of the library at a size that a machine may have."
        if not missing
        else f'<b class="unseen">Not excited</b>, so that the record says nothing about them: '
        f"{listed([_lower(name) for name in missing])}."
    )
    return (
        f"<p>{words}</p>\n<p>The table has the smallest size of each effect that would have "
        "been seen in this record.</p>\n"
    ) + tables.detectability(e.detectability, joints)


def _feedback(e: Explanation) -> str:
    found = e.feedback_bias
    if found is None:
        return ""
    mark = '<b class="unseen">Feedback shows.</b> ' if found.biased else ""
    return (
        f"<p>{mark}{text(found.sentence)}</p>\n{tables.feedback(found)}"
        f'<p class="soft">Test of Durbin, Wu and Hausman; instruments: '
        f"{text(found.instruments)}. A small p-value says that noise went round through the "
        "controller, which makes false delay and elasticity.</p>\n"
    )


def _next(e: Explanation) -> str:
    found = e.next_experiment
    if found is None:
        return ""
    parts = [f"<p>{text(found.sentence)}</p>\n"]
    if found.separate:
        parts.append(f"<p>It separates {listed([hypothesis(h, True) for h in found.separate])}.</p>\n")
    if found.command:
        parts.append(f"<pre><code>{text(found.command)}</code></pre>\n")
    return "".join(parts)


def _parameters(e: Explanation) -> str:
    if not e.parameters:
        return ""
    return (
        "<p>Values at the start and after retuning, together with what was found. A parameter "
        "that moves by many widths of its prior is a symptom of something else.</p>\n"
    ) + tables.parameters_retuned(e.parameters)


def _logs(e: Explanation) -> str:
    fitted = "<br>".join(text(name) for name in e.logs) or DASH
    kept = "<br>".join(text(name) for name in e.held_out_logs)
    own = "quarters of the same log, each by parameters fitted to the others" if "held_out" in e.errors else DASH
    facts = [
        ("Fitted", fitted),
        ("Held out", kept or own),
        ("Mechanism", mechanism(e)),
        ("Seed", str(e.seed)),
        ("Version", text(e.version or __version__)),
    ]
    if e.seconds and math.isfinite(e.seconds):
        facts.append(("Run time", quantity(e.seconds, "s")))
    return '<dl class="facts">\n' + "".join(f"<dt>{name}</dt><dd>{value}</dd>\n" for name, value in facts) + "</dl>\n"


def _drawn(charts: list[Chart], prefix: str, kind: str = "") -> str:
    drawn = "".join(
        f"<figure>\n<figcaption>{text(chart.title)}</figcaption>\n"
        f"{svg(chart, f'{prefix}-{index}')}\n"
        f"{f'<p>{text(chart.note)}</p>' if chart.note else ''}</figure>\n"
        for index, chart in enumerate(charts)
    )
    return f'<div class="figures{" " + kind if kind else ""}">\n{drawn}</div>\n'


def _legend(keys: list[tuple]) -> str:
    items = "".join(
        f"<li>{key_svg(kind, colour, mark=mark[0] if mark else 'circle')}<span>{words}</span></li>\n"
        for kind, colour, words, *mark in keys
    )
    return f'<ul class="legend">\n{items}</ul>\n'


def _lower(name: str) -> str:
    """A name inside a sentence; proper names keep their capital."""
    return name if name.startswith(("Coulomb", "Stribeck")) else name[:1].lower() + name[1:]


def _base_name(path: str) -> str:
    return path.rstrip("/").rsplit("/", 1)[-1]


def _log_names(e: Explanation) -> str:
    names = [text(_base_name(each)) for each in e.logs]
    if not names:
        return "no log"
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
