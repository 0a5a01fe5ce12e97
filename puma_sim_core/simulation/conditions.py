# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Conditions of a run (section 6.1): constraints of joints, and the limits that samples are checked against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from puma_sim_core.checks import check_choice, is_number
from puma_sim_core.errors import ParameterError
from puma_sim_core.recording.recording import Recording

CONSTRAINTS = ("free", "hold", "velocity", "acceleration")


@dataclass(frozen=True)
class Constraint:
    """How a joint moves (section 6.1, a to d).

    kind : "free", "hold" (constant position), "velocity" (constant velocity) or "acceleration" (constant acceleration).
        value : the velocity [rad/s], None for the initial one, or the acceleration [rad/s^2].

    A joint that is not free has its row and column taken out of the equations; what it exerts on the others by its
    motion stays. (Section 6.2 overwrites its state after a free step, which leaves the others with a wrong inertia.)

    Raises ParameterError: unknown kind, or a value where none belongs or one is missing.
    """

    kind: str = "free"
    value: float | None = None

    def __post_init__(self) -> None:
        check_choice(self.kind, "constraint", CONSTRAINTS)
        expected = None
        if self.value is None:
            expected = "acceleration:RAD_PER_S2" if self.kind == "acceleration" else None
        elif self.kind in ("free", "hold"):
            expected = "no value"
        elif not is_number(self.value):
            expected = "a finite number"
        else:
            # a whole number here would be compiled as another kernel
            object.__setattr__(self, "value", float(self.value))
        if expected:
            what = "no value" if self.value is None else f"value {self.value}"
            raise ParameterError(what, where=f"constraint '{self.kind}'", expected=expected)

    @classmethod
    def parse(cls, text: str) -> Constraint:
        """From ``free``, ``hold``, ``velocity``, ``velocity:0.5`` or ``acceleration:1``."""
        kind, colon, value = text.partition(":")
        try:
            number = float(value) if colon else None
        except ValueError:
            raise ParameterError(f"value '{value}'", where=f"constraint '{kind}'", expected="a number") from None
        return cls(kind, number)


@dataclass(frozen=True)
class Limits:
    """Ranges and greatest magnitudes that a run is checked against, at its samples.

    position ((low, high) x 3) [rad], velocity (3) [rad/s], acceleration (3) [rad/s^2]; None
    leaves a quantity unchecked; unit: "m" in place of "rad" for a slide. Limits stop nothing: a
    stop that acts is an effect.
    """

    position: tuple[tuple[float, float], ...] | None = None
    velocity: tuple[float, ...] | None = None
    acceleration: tuple[float, ...] | None = None
    unit: str = "rad"

    def first_exceeded(self, recording: Recording) -> list[str]:
        """One sentence for each joint and quantity that leaves its limits: where and by what."""
        found = []
        for name, per in (("position", ""), ("velocity", "/s"), ("acceleration", "/s^2")):
            limits, values = getattr(self, name), getattr(recording, name)
            if limits is None or values is None:
                continue
            for j, limit in enumerate(limits):
                low, high = limit if name == "position" else (-limit, limit)
                outside = np.flatnonzero((values[:, j] < low) | (values[:, j] > high))
                if outside.size:
                    r = int(outside[0])
                    value, at = f"{values[r, j]:.7g} {self.unit}{per}", f"{recording.time[r]:.6g} s"
                    found.append(f"joint {j + 1}: {name} {value} at {at} is outside {low:.4g} to {high:.4g}")
        return found
