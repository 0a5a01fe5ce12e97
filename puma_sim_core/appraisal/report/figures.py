# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Figures of the page, as data."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np

from puma_sim_core.appraisal.perturbations.sizes import SEARCHED, size_at
from puma_sim_core.appraisal.report.table import Table
from puma_sim_core.appraisal.report.words import words
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.arm.kinematics import wrist_path
from puma_sim_core.effects import KINDS
from puma_sim_core.pages.figure import Figure, Layer

#: colours and strokes of controllers, in their order; both begin again behind the last
_COLOURS = ("blue", "orange", "green", "purple", "black", "yellow", "sky")
_DASHES = ((), (4.0, 2.0), (1.0, 1.5))
#: tasks that are drawn: over time, and in the plane of the path
STEP_TASK, PATH_TASK = "simultaneous_steps", "line_50"


def _look(number: int) -> dict[str, Any]:
    dashes = _DASHES[number // len(_COLOURS) % len(_DASHES)]
    return {"colour": _COLOURS[number % len(_COLOURS)], "dashes": dashes}


def profiles(table: Table) -> Figure:
    """Performance profiles: the share of trials with at least a score."""
    rows = table.rows()
    levels = np.linspace(0.0, 1.0, 201)
    layers = [Layer("line", np.array([0.5, 0.5]), np.array([0.0, 1.0]), colour="grey", dashes=(2.0, 2.0))]
    for number, name in enumerate(table.battery.controllers):
        scores = table.scores[rows, number]
        share = (scores[:, None] >= levels).mean(axis=0)
        layers.append(Layer("line", levels, share, label=name, **_look(number)))
    note = "At 0.5, the dashed line, a trial is just passed; a curve that is higher everywhere is better."
    return Figure(
        "Performance profiles", "score", "share of trials with that score or more", tuple(layers), (0.0, 1.0),
        (0.0, 1.02), note=note,
    )  # fmt: skip


def steps(table: Table, responses: Mapping[str, Response]) -> list[Figure]:
    """The three joints in the nominal trial of the simultaneous steps."""
    found = []
    for j in range(3):
        layers: list[Layer] = []
        for number, (name, response) in enumerate(responses.items()):
            rows = slice(0, None, max(1, len(response.time) // 600))
            time = response.time[rows]
            if not layers:
                layers.append(Layer("steps", time, response.reference[rows, j], label="setpoint", colour="grey"))
            layers.append(Layer("line", time, response.position[rows, j], label=name, **_look(number)))
        found.append(Figure(f"Joint {j + 1}", "time [s]", "position [rad]", tuple(layers)))
    return found


def path(table: Table, responses: Mapping[str, Response]) -> Figure:
    """The wrist in the nominal trial of the line with a corner, from the front."""
    layers: list[Layer] = []
    for number, (name, response) in enumerate(responses.items()):
        rows = slice(0, None, max(1, len(response.time) // 600))
        arm = table.battery.setting.nominal.arm
        if not layers:
            wanted = wrist_path(response.reference[rows], arm)
            layers.append(Layer("line", wanted[:, 1], wanted[:, 2], label="commanded", colour="grey", width=3.0))
        made = wrist_path(response.position[rows], arm)
        layers.append(Layer("line", made[:, 1], made[:, 2], label=name, **_look(number)))
    return Figure("Wrist along a line with a corner", "y [m]", "z [m]", tuple(layers), equal=True, height=3.4)


def critical(found: Mapping[str, Any], controllers: list[str]) -> Figure | None:
    """Critical sizes of all effects, the most delicate first, on the scale of what machines have: 0 the least
    plausible, 1 the greatest; with a line for what the draws of the arm span."""
    rows = [each for each in found["critical_sizes"] if each["size"] is not None]
    least: dict[str, float] = {}
    for each in rows:
        least[each["effect"]] = min(least.get(each["effect"], inf), each["size"])
    effects = sorted(least, key=lambda name: (-least[name], name))
    if not effects:
        return None
    layers = []
    shown = [name for name in controllers if any(each["controller"] == name for each in rows)]
    for number, name in enumerate(shown):
        own = [each for each in rows if each["controller"] == name]
        y = [effects.index(each["effect"]) + 0.11 * (0.5 * (len(shown) - 1) - number) for each in own]
        look = {"colour": _look(controllers.index(name))["colour"]}
        spans = [
            [size_at(KINDS[each["effect"].partition(":")[0]], each[end]) for end in ("low", "high")] for each in own
        ]
        x = np.hstack([np.array(spans), np.full((len(own), 1), np.nan)]).ravel()
        layers.append(Layer("line", x, np.repeat(y, 3), width=0.8, opacity=0.6, **look))
        size = np.array([each["size"] for each in own])
        layers.append(Layer("marks", size, np.array(y), label=name, marker="o", size=3.6, **look))
    return Figure(
        "Critical sizes",
        "0: the least that machines have, 1: the greatest",
        "",
        tuple(layers),
        (min(-0.05, min(least.values()) - 0.15), SEARCHED[1] + 0.05),
        (-0.7, len(effects) - 0.3),
        y_names=tuple(words(name) for name in effects),
        height=0.2 * len(effects) + 0.9,
        width=7.6,
        note="The size from which on a controller fails, the median over the draws of the arm, and their range with "
        "that of the last bisection; further left is more delicate. What is missing here is never critical, or fails "
        "at every size: see the table.",
    )
