# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A motion that can be shown: positions over time, and what was recorded beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from puma_sim_core.pages.figure import Figure, Layer
from puma_sim_core.view.chain import Chain

#: names of the arms of a motion, as the scene and the plots show them
ARM, SETPOINT, MODEL = "arm", "setpoint", "model"
#: rows of a plot: as many as a screen has columns for them; of a longer record every n-th row is drawn
PLOTTED_ROWS = 1500
#: how each arm is drawn, from the bottom to the top; the arm itself has a colour for each joint
LOOKS: dict[str, dict[str, Any]] = {
    SETPOINT: {"colour": "yellow", "width": 2.6},
    ARM: {},
    MODEL: {"colour": "purple", "dashes": (3.0, 2.0)},
}
_COLOURS = ("blue", "orange", "green", "sky", "black", "grey")


@dataclass(frozen=True, eq=False)
class Motion:
    """n rows of J joints; None for what was not recorded.

    name : what is shown; chain : the links. time (n,) [s], rising; position, setpoint (n, J) [rad or m, by `unit`];
    voltage (n, J) [V], which holds until the next row; current (n, J) [A]; model (n, J): positions of a model that was
    given the voltages of the record; notes : sentences on what was left out.
    """

    name: str
    chain: Chain
    time: np.ndarray
    position: np.ndarray
    unit: str = "rad"
    setpoint: np.ndarray | None = None
    voltage: np.ndarray | None = None
    current: np.ndarray | None = None
    model: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def arms(self) -> dict[str, np.ndarray]:
        """Positions (n, J) of the arm that moved, of its setpoint and of the model, as far as there are any."""
        arms = {ARM: self.position, SETPOINT: self.setpoint, MODEL: self.model}
        return {name: values for name, values in arms.items() if values is not None}

    @property
    def _scale(self) -> tuple[float, str]:
        """Factor and unit in which positions are drawn."""
        return (float(np.degrees(1.0)), "deg") if self.unit == "rad" else (1e3, "mm")

    def _series(self) -> Iterator[tuple[str, str, str, np.ndarray]]:
        """(words, unit, kind of layer, values (n, J)) of all that is drawn but positions."""
        scale, unit = self._scale
        if self.setpoint is not None:
            yield "tracking error", unit, "line", scale * (self.setpoint - self.position)
        if self.model is not None:
            yield "residual, arm minus model", unit, "line", scale * (self.position - self.model)
        if self.voltage is not None:
            yield "motor voltage", "V", "steps", self.voltage
        if self.current is not None:
            yield "motor current", "A", "line", self.current

    def at(self, time: float) -> dict[str, np.ndarray]:
        """Positions (J,) of each of `arms` at a time [s], on the line between two rows."""
        return {name: interpolated(time, self.time, values) for name, values in self.arms.items()}

    def figures(self) -> list[Figure]:
        """Plots over time: positions with setpoint and model, tracking error, residual, voltage, current."""
        rows = slice(None, None, -(-len(self.time) // PLOTTED_ROWS))
        scale, unit = self._scale

        def layers(values: np.ndarray, kind: str = "line", arm: str = ARM) -> list[Layer]:
            return [
                Layer(
                    kind,
                    self.time[rows],
                    y,
                    **{"label": f"joint {j}" if arm == ARM else arm, "colour": colour, **LOOKS[arm]},
                )
                for j, (colour, y) in enumerate(zip(_COLOURS, values[rows].T), start=1)
            ]

        positions = [
            layer for arm in LOOKS if arm in self.arms for layer in layers(scale * self.arms[arm], "line", arm)
        ]
        found = [Figure("Position", "time [s]", f"position [{unit}]", tuple(positions), height=2.3)]
        for words, unit, kind, values in self._series():
            title, drawn = words.capitalize(), tuple(layers(values, kind))
            found.append(
                Figure(title, "time [s]", f"{words.partition(',')[0].split()[-1]} [{unit}]", drawn, height=1.9)
            )
        return found


def interpolated(time: float, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(J,) values at a time between rows; the first or last row beyond them. times (n,), values (n, J)."""
    return np.array([np.interp(time, times, column) for column in values.T])
