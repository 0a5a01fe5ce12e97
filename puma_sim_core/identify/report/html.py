# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The report that a person reads; markup and sentences stand in `templates`, in a macro for each section."""

from inspect import getmembers, isfunction

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.report import answers, figures, tables, text
from puma_sim_core.identify.result import NOTHING_MISSING, Explanation
from puma_sim_core.pages import text as words
from puma_sim_core.pages.page import environment, render

#: the sections by the names of their macros, in the order of their weight
_TITLES = {
    "faults": "Faults of the data",
    "found": "What was found",
    "shape": "What has no name",
    "errors": "How much better",
    "residual": "Residual before and after",
    "link_side": "Both sides of the transmission",
    "agreement": "Same answer across logs",
    "ranking": "Why this, and not another",
    "whiteness": "What is left",
    "unseen": "What this record could not have shown",
    "feedback": "Feedback in the recording",
    "next": "What to measure next",
    "parameters": "Parameters retuned",
    "logs": "Logs and settings",
}
_PAGES = environment(
    "puma_sim_core.identify.report",
    answers=answers,
    draw=figures,
    tables=tables,
    kinds=KINDS,
    base_name=lambda path: path.rstrip("/").rsplit("/", 1)[-1],
    joints_of=lambda e: max(
        [each.joint or 1 for each in e.detectability]
        + [np.size(errors.position_rms.nominal) for errors in e.errors.values()]
    ),
    unit=words.unit_text,
    **dict([*getmembers(words, isfunction), *getmembers(text, isfunction)]),
)
_PAGES.filters.update(effect_name=words.effect_name, gain=text.gain, hypothesis=text.hypothesis)


def page(explanation: Explanation) -> str:
    """The whole page; the same explanation gives the same text."""
    order = list(_TITLES)
    if explanation.verdict == NOTHING_MISSING:
        order.remove("unseen")
        order.insert(2, "unseen")
    macros = _PAGES.get_template("sections.html").module
    contents = {name: getattr(macros, name)(explanation).strip() for name in order}
    sections = [(name, _TITLES[name], content) for name, content in contents.items() if content]
    return render(_PAGES, "report.html", e=explanation, sections=sections)
