# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The arm under any controller object, sample by sample.

A controller has an attribute ``period`` [s], its stated rate, and the methods ``reset()`` and
``update(t, setpoint, measurement)``, which gets three setpoints and three measured positions [rad]
and gives three voltages [V]. Around it stands the chain of the digital servo: encoder counts
before it; its own limit, the converter, the amplifier and the delay behind it. With the PID
controller in it the loop gives the same bits as the servo that is compiled into the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Protocol

import numpy as np

from .backend import BACKEND, interpreted
from .control.servo import SERVO_WIDTH, ServoConfig, quantised
from .errors import ParameterError
from .runs import run_voltages, terminal_voltages

_quantised = interpreted(quantised)


class Controller(Protocol):
    """What the loop asks of a controller."""

    period: float

    def reset(self) -> None:
        """Forget the past."""

    def update(self, t: float, setpoint: Sequence[float],
               measurement: Sequence[float]) -> Sequence[float]:
        """Three voltages [V] at time t [s]; setpoint, measurement: three positions [rad]."""


def samples_per_period(controller: Controller, period: float) -> int:
    """Samples of the controller between two setpoints, which come each `period` [s].

    Raises
    ------
    ParameterError : the period is not a whole number of the controller's own.
    """
    samples = round(period / controller.period)
    if samples < 1 or abs(samples * controller.period - period) > 1e-9 * period:
        raise ParameterError(f"its period is {controller.period!r} s", where="controller",
                             expected=f"a whole part of the {period!r} s between setpoints")
    return samples


class ControlLoop:
    """A controller, its chain and the arm.

    Parameters
    ----------
    controller : see the module.
    chain : whose encoder, converter, amplifier and delay are used; its gains are not.
    sample : time between samples [s]; steps : steps of integration in each.
    voltage_limit : at the motor [V]; gear_ratios : of the three joints, for the encoders.
    kernel : (body, drive, active, table, lock), as the kernel takes them.
    """

    def __init__(self, controller: Controller, chain: ServoConfig, sample: float, steps: int,
                 voltage_limit: float, gear_ratios, kernel):
        self.controller = controller
        table = chain.table(sample, voltage_limit, gear_ratios)
        self._limit, self._amplifier = table[3], table[6]
        self._converter_step, self._delay = table[5], int(table[8])
        self._encoder_steps = table[4::SERVO_WIDTH]
        self._sample = sample
        self._kernel = kernel
        compiled = BACKEND == "numba"
        self._counts = np.array([steps]) if compiled else [steps]
        self._steps = np.array([sample / steps]) if compiled else [sample / steps]
        self._row = np.zeros((1, 3)) if compiled else [[0.0, 0.0, 0.0]]
        self._out = np.empty((2, 12))
        self.reset()

    def reset(self, held_voltage=(0.0, 0.0, 0.0)) -> None:
        """Forget the past; held_voltage [V] is what a delay gives before the first sample."""
        self.controller.reset()
        self._late = [tuple(float(v) for v in held_voltage)] * self._delay

    def run(self, x, z, setpoints, samples: int, start: float, out, volts) -> int:
        """Run from state x and bristles z; each row of setpoints (n, 3) [rad] acts for `samples`.

        start : time of the first sample [s]. Fills out (n * samples + 1, 12), a row a sample, and
        volts (n * samples, 3) at the motors. Returns the first row of `out` that is not finite,
        or -1.
        """
        out[0, :9], out[0, 9:] = x, z
        row = 0
        for setpoint in setpoints:
            setpoint = tuple(float(value) for value in setpoint)
            for _ in range(samples):
                asked = self._voltages(start + self._sample * row, setpoint, x)
                if asked is None or self._advance(x, z, asked):
                    return row + 1
                volts[row] = terminal_voltages(*asked, self._kernel[3])
                row += 1
                out[row] = self._out[1]
                values = tuple(self._out[1].tolist())
                x, z = values[:9], values[9:]
        return -1

    def _voltages(self, t, setpoint, x):
        """Commanded motor voltages [V], or None where the controller's are not finite."""
        measured = tuple(_quantised(q, step) for q, step in zip(x, self._encoder_steps))
        asked = tuple(self.controller.update(t, setpoint, measured))
        if len(asked) != 3:
            raise ParameterError(f"{len(asked)} voltages", where="controller", expected="three")
        if not all(map(isfinite, asked)):
            return None
        asked = tuple(self._converted(float(u)) for u in asked)
        if self._delay:
            self._late.append(asked)
            asked = self._late.pop(0)
        return asked

    def _converted(self, u: float) -> float:
        limit, step = self._limit, self._converter_step
        u = _quantised(min(max(u, -limit), limit), step)
        # the converter's highest code is one step short of its lowest, as in two's complement
        if step > 0.0:
            u = min(u, limit - step)
        return u * self._amplifier

    def _advance(self, x, z, volts) -> bool:
        """One sample with the voltages held; whether it failed to stay finite."""
        row = self._row[0]
        row[0], row[1], row[2] = volts
        try:
            return run_voltages(x, z, self._row, self._counts, self._steps, *self._kernel,
                                self._out) >= 0
        except (OverflowError, ValueError, ZeroDivisionError):
            # plain Python tells some numbers that are not finite by an exception
            return True
