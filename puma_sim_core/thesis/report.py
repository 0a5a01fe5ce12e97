# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The page: every experiment with its rows, its figures and the printed numbers beside ours.

One HTML file that needs no network: drawings and style stand inside it, and there is no script.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

from puma_sim_core import __version__
from puma_sim_core.thesis.drawing import legend_svg, styles, svg
from puma_sim_core.thesis.registry import Experiment
from puma_sim_core.thesis.result import Figure, Heatmap, Result, Row
from puma_sim_core.thesis.style import CSS

#: lists longer than this stand in the JSON alone
_LIST = 6
_TITLE = "The thesis, reproduced"
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_HEAD = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>{css}</style>
</head>
<body>
"""


def page(
    results: Mapping[str, tuple[Experiment, Result]], seed: int, progress: Callable[[float], None] = lambda share: None
) -> str:
    """The page of these experiments, in their order.

    Parameters
    ----------
    results : the experiments by number, each with what it found.
    seed : the seed that they were run with, named on the page.
    progress : called with the share of the experiments that are drawn.

    Raises
    ------
    ParameterError : matplotlib is missing.
    """
    parts = [_HEAD.format(title=_TITLE, css=CSS, policy=_POLICY), _opening(), _contents(results), "<main>\n"]
    for index, (found, result) in enumerate(results.values()):
        parts.append(_section(found, result))
        progress((index + 1) / len(results))
    parts.append(
        "</main>\n<footer><p>Made by puma-sim "
        f"{escape(__version__)}, seed {seed}. "
        "The numbers and the curves stand in the JSON file beside this page.</p>"
        "</footer>\n</body>\n</html>\n"
    )
    return "".join(parts)


def first_sentence(text: str) -> str:
    """The first sentence of a summary, for lists of contents."""
    return re.split(r"(?<=[.!?])\s+(?=[A-Z])", " ".join(text.split()), maxsplit=1)[0]


def number_text(value: Any) -> str:
    """A number with five digits and a proper minus; words as they are; "" for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not _is_number(value):
        return str(value)
    text = str(value) if isinstance(value, int) else f"{value:.5g}"
    mantissa, _, exponent = text.partition("e")
    text = mantissa.replace("-", "\N{MINUS SIGN}")
    if exponent:
        text += f"\N{MULTIPLICATION SIGN}10^{int(exponent)}"
    return text


def _opening() -> str:
    return (
        f'<header id="top"><h1>{_TITLE}</h1>\n'
        "<p>Each experiment of chapters 2 to 8 of the thesis on the control of the PUMA 560, run "
        "on the model with its misprints corrected. Where the thesis prints a number or a plot, "
        "it stands beside ours; where the two differ, a sentence says why, as far as is known. "
        "Nothing was fitted to the print, and nothing that does not reproduce was left out.</p>\n"
        '<p>A row is marked <span class="mark agrees" style="display:inline">agrees</span> when '
        "the numbers are within 1 % of each other (in section 4.5: within the digits printed), and "
        '<span class="mark differs" style="display:inline">differs</span> when they are not. An '
        "empty cell means that the thesis prints no number there.</p></header>\n"
    )


def _contents(results: Mapping[str, tuple[Experiment, Result]]) -> str:
    lines = [
        f'<li><span class="number">{escape(_number(found))}</span><div>'
        f'<a href="#{_anchor(found)}">{escape(found.title)}</a>'
        f"<p>{_rich(first_sentence(result.summary))}</p></div></li>\n"
        for found, result in results.values()
    ]
    return f'<nav aria-label="Contents"><h2>Contents</h2>\n<ol>\n{"".join(lines)}</ol></nav>\n'


def _section(found: Experiment, result: Result) -> str:
    anchor = _anchor(found)
    number = _number(found)
    shown = f'<span class="number">{escape(number)}</span> ' if number else ""
    parts = [f'<section id="{anchor}">\n<h2>{shown}{escape(found.title)}</h2>\n']
    parts += [f"<p>{_rich(paragraph)}</p>\n" for paragraph in re.split(r"\n\s*\n", result.summary.strip())]
    errata = found.number == "errata"
    parts.append(_table(result.rows, ("Place", "Printed", "Correct", "Effect on the numbers") if errata else None))
    if result.page_rows:
        parts.append("<h3>Measured on this run, and so not in the JSON</h3>\n")
        parts.append(_table(result.page_rows))
    figures = (*result.figures, *result.page_figures)
    if figures:
        drawn = [_figure(figure, f"{anchor}-{index}") for index, figure in enumerate(figures)]
        parts.append(f'<div class="figures">\n{"".join(drawn)}</div>\n')
    parts.append(_numbers(result.numbers))
    parts.append('<p class="top"><a href="#top">Contents</a></p>\n</section>\n')
    return "".join(parts)


def _table(rows: tuple[Row, ...], heads: tuple[str, ...] | None = None) -> str:
    if not rows:
        return ""
    names = heads or ("Quantity", "Thesis", "Ours", "Where and why they differ")
    lines = []
    for row in rows:
        unit = f"\N{NO-BREAK SPACE}[{_rich(row.unit)}]" if row.unit not in ("", "1") else ""
        mark, off = "", row.differs
        if off is not None and heads is None:
            word = "differs" if off else "agrees"
            mark = f' <span class="mark {word}">{word}</span>'
        block = " block" if "\n" in f"{row.printed}{row.ours}" else ""
        cells = [
            (names[1], f"value printed{block}", _rich(number_text(row.printed))),
            (names[2], f"value ours{block}", _rich(number_text(row.ours)) + mark),
            ("", "note", _rich(row.note)),
        ]
        lines.append(
            f'<tr><th scope="row">{_rich(row.quantity)}{unit}</th>'
            + "".join(
                f'<td class="{kind}"{f" data-name={chr(34)}{name}{chr(34)}" if name else ""}>{text}</td>'
                for name, kind, text in cells
            )
            + "</tr>\n"
        )
    head = "".join(f'<th scope="col">{name}</th>' for name in names)
    kind = ' class="words"' if heads else ""
    return f"<table{kind}>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(lines)}</tbody>\n</table>\n"


def _figure(figure: Figure | Heatmap, prefix: str) -> str:
    # the thesis's plots are all in chapter 7; other keys belong to drawings of our own
    name = f"Plot {figure.key}" if re.fullmatch(r"7\.\d+[a-z]?", figure.key) else ""
    if figure.key.startswith("figure "):
        name = figure.key.capitalize()
    title = f"{name}. {figure.title}" if name else figure.title
    legend = ""
    if isinstance(figure, Figure) and (len(figure.curves) > 1 or figure.curves[0].label):
        items = "".join(
            f"<li>{legend_svg(style)}<span>{_rich(curve.label)}</span></li>"
            for curve, style in zip(figure.curves, styles(figure))
        )
        legend = f'<ul class="legend">{items}</ul>\n'
    note = f"<p>{_rich(figure.note)}</p>\n" if figure.note else ""
    return f"<figure>\n<figcaption>{_rich(title)}</figcaption>\n{svg(figure, prefix)}\n{legend}{note}</figure>\n"


def _numbers(numbers: Mapping[str, Any]) -> str:
    if not numbers:
        return ""
    items = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{_rich(_short(value))}</dd></div>\n" for name, value in numbers.items()
    )
    return (
        f'<details><summary>Further numbers ({len(numbers)})</summary>\n<dl class="numbers">\n{items}</dl></details>\n'
    )


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return f"{len(value)} entries, in the JSON"
    if isinstance(value, list):
        if len(value) > _LIST or any(isinstance(item, (list, dict)) for item in value):
            return f"{len(value)} values, in the JSON"
        return ", ".join("none" if item is None else number_text(item) for item in value)
    return "none" if value is None else number_text(value)


def _rich(text: str) -> str:
    """Escaped, with powers raised: kg.m^2, 10^-5."""
    raised = re.sub(
        r"\^(\(?)([-\N{MINUS SIGN}+]?[0-9]+)(\)?)",
        lambda m: f"<sup>{m[2]}</sup>" if bool(m[1]) == bool(m[3]) else m[0],
        escape(text),
    )
    return re.sub(r"<sup>-", "<sup>\N{MINUS SIGN}", raised)


def _number(found: Experiment) -> str:
    return found.number if found.number[:1].isdigit() else ""


def _anchor(found: Experiment) -> str:
    return "e" + re.sub(r"[^0-9A-Za-z]+", "-", found.number)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
