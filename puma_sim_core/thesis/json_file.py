# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Results as JSON: the same results, the same bytes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from puma_sim_core import __version__
from puma_sim_core import json_text as layout
from puma_sim_core.thesis.drawing import thin
from puma_sim_core.thesis.registry import Experiment
from puma_sim_core.thesis.result import Figure, Heatmap, Result, Row

#: raised when the layout of the file changes
FORMAT = 1


def json_text(results: Mapping[str, tuple[Experiment, Result]], seed: int) -> str:
    """The results of experiments by number; rows and figures in order, all keys sorted.

    Numbers stand with as many digits as tell them from their neighbours. A gap of a curve is
    null. Rows and figures that change from run to run are left out.
    """
    content = {
        "format": FORMAT,
        "version": __version__,
        "seed": seed,
        "experiments": [
            {
                "number": found.number,
                "chapter": found.chapter,
                "title": found.title,
                "summary": result.summary,
                "rows": [_row(row) for row in result.rows],
                "figures": [_figure(figure) for figure in result.figures],
                "numbers": dict(result.numbers),
            }
            for found, result in results.values()
        ],
    }
    return layout.json_text(content, sort_keys=True)


def _row(row: Row) -> dict[str, Any]:
    differs = row.differs
    return {
        "quantity": row.quantity,
        "unit": row.unit,
        "printed": row.printed,
        "ours": row.ours,
        "note": row.note,
        "agrees": None if differs is None else not differs,
    }


def _figure(figure: Figure | Heatmap) -> dict[str, Any]:
    common = {
        "key": figure.key,
        "title": figure.title,
        "note": figure.note,
        "x_label": figure.x_label,
        "y_label": figure.y_label,
    }
    if isinstance(figure, Heatmap):
        return {
            **common,
            "value_label": figure.value_label,
            "x": _list(figure.x),
            "y": _list(figure.y),
            "values": [_list(row) for row in figure.values],
        }
    curves = []
    for curve in figure.curves:
        x, y = thin(curve)
        curves.append({"label": curve.label, "style": curve.style, "x": _list(x), "y": _list(y)})
    return {**common, "log_x": figure.log_x, "log_y": figure.log_y, "curves": curves}


def _list(values) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]
