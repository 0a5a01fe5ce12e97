# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The panel beside the scene: a heading, buttons, the values of the moment, and plots that zoom by dragging."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from puma_sim_core.pages.figure import COLOURS, Figure, Layer

_WIDTH, _PLOT_HEIGHT = 420, 150  # CSS pixels


class Panel:
    """The panel of a viser server.

    name : the heading; notes : sentences below it.
    """

    def __init__(self, server: Any, name: str, notes: Sequence[str] = ()) -> None:
        self._gui = server.gui
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(_WIDTH)
        small = "".join(f"<div style='font-size:.75em'>{html.escape(note)}</div>" for note in notes)
        server.gui.add_html(
            f"<div style='margin:0 .8em;overflow-wrap:anywhere'><b>{html.escape(name)}</b>{small}</div>"
        )
        self._table: Any = None
        self._plots: list[Any] = []

    def add_buttons(self, words: Sequence[str], press: Callable[[str], None]) -> None:
        """Buttons side by side; `press` gets the words of the one that was pressed, in the order of the presses, in the
        server's event loop, which it must not keep."""
        buttons = self._gui.add_button_group("", words)

        # a plain function would run in a pool of threads, where a later press may overtake an earlier one
        @buttons.on_click
        async def _(event: Any) -> None:
            press(event.target.value)

    def draw(self, figures: Sequence[Figure], moment: float | None = None) -> None:
        """Draw plots over one time, and the values at a moment [s], which has a line in them; None: the last values.

        The first call lays the plots out; later ones have the same figures with other data.
        """
        if not self._plots:
            self._table = self._gui.add_html(_table(figures, moment))
            self._plots = [self._add(figure, moment) for figure in figures]
            return
        self._table.content = _table(figures, moment)
        for plot, figure in zip(self._plots, figures):
            plot.data = _columns(figure, moment)

    def _add(self, figure: Figure, moment: float | None) -> Any:
        lines: list[dict[str, Any]] = [
            {
                "label": each.label,
                "stroke": COLOURS[each.colour][0],
                "width": each.width,
                "dash": [4 * d for d in each.dashes],
            }
            for each in figure.layers
        ]
        scales: dict[str, Any] = {"x": {"time": False}}
        if moment is not None:
            lines.append({"label": "now", "stroke": COLOURS["ink"][0], "width": 1.0})
            # the line of the moment reaches from edge to edge of a range that stays
            scales["y"] = {"range": _range(figure)}
        return self._gui.add_uplot(
            _columns(figure, moment),
            ({"label": figure.x_label}, *lines),
            axes=({"size": 26}, {"size": 46, "label": figure.y_label, "labelSize": 18, "labelGap": 2}),
            legend={"show": False},
            scales=scales,
            height=_PLOT_HEIGHT,
        )


def _range(figure: Figure) -> tuple[float, float]:
    low = min(float(np.min(layer.y)) for layer in figure.layers)
    high = max(float(np.max(layer.y)) for layer in figure.layers)
    margin = 0.06 * (high - low) or 0.5
    return low - margin, high + margin


def _columns(figure: Figure, moment: float | None) -> tuple[np.ndarray, ...]:
    """Time and lines of a plot; the line of the moment is a spike on the lower edge, for which rows are inserted."""
    time = figure.layers[0].x
    if moment is None:
        return (time, *(layer.y for layer in figure.layers))
    row, (low, high) = int(np.searchsorted(time, moment)), _range(figure)
    lines = [np.insert(layer.y, row, 3 * [_value(layer, moment)]) for layer in figure.layers]
    spike = np.full(len(time) + 3, low)
    spike[row + 1] = high
    return (np.insert(time, row, 3 * [moment]), *lines, spike)


def _value(layer: Layer, moment: float | None) -> float:
    """Value of a layer at a moment [s], None for the last."""
    if moment is None:
        return float(layer.y[-1])
    if layer.kind == "steps":
        return float(layer.y[max(0, int(np.searchsorted(layer.x, moment, "right")) - 1)])
    return float(np.interp(moment, layer.x, layer.y))


def _table(figures: Sequence[Figure], moment: float | None) -> str:
    """The values of each joint as HTML."""
    rows = []
    for figure in figures:
        joints = [layer for layer in figure.layers if layer.label.startswith("joint")]
        head = "".join(f"<th style='color:{COLOURS[joint.colour][0]}'>{joint.label}</th>" for joint in joints)
        # no minus before a zero
        cells = "".join(f"<td>{round(_value(joint, moment), 3) + 0.0:.3f}</td>" for joint in joints)
        rows.append(f"<tr><td style='text-align:left'>{html.escape(figure.y_label)}</td>{cells}</tr>")
    style = "width:calc(100% - 1.6em);margin:0 .8em;font-size:.8em;text-align:right;font-variant-numeric:tabular-nums"
    return f"<table style='{style}'><tr><th></th>{head}</tr>{''.join(rows)}</table>"
