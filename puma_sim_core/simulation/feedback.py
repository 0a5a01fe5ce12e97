# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The arm under any controller object, sample by sample.

A controller has an attribute ``period`` [s], its stated rate, and the methods ``reset()`` and
``update(t, setpoint, measurement)``, which gets three setpoints and three measured positions [rad]
and gives three voltages [V]. Around it stands the chain of the digital servo: encoder counts
before it; its own limit, the converter, the amplifier and the delay behind it. The positions that
it gets are the measured ones, with the plant's effects of sensing in them. With the PID
controller in it the loop gives the same bits as the servo that is compiled into the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Protocol

import numpy as np

from puma_sim_core.dynamics.laws import AT_REST, SENSED
from puma_sim_core.dynamics.runs import ROW, WIDE, WIDE_ROW
from puma_sim_core.dynamics.servo import SERVO_WIDTH, ServoConfig, quantised
from puma_sim_core.dynamics.two_mass_runs import run_voltages
from puma_sim_core.dynamics.types import Rows, State
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import BACKEND, interpreted
from puma_sim_core.simulation.delay import SampledDelay

_quantised = interpreted(quantised)


class Controller(Protocol):
    """What the loop asks of a controller."""

    period: float

    def reset(self) -> None:
        """Forget the past."""

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> Sequence[float]:
        """Three voltages [V] at time t [s]; setpoint, measurement: three positions [rad]."""


def samples_per_period(controller: Controller, period: float) -> int:
    """Samples of the controller between two setpoints, which come each `period` [s].

    Raises
    ------
    ParameterError : the period is not a whole number of the controller's own.
    """
    samples = round(period / controller.period)
    if samples < 1 or abs(samples * controller.period - period) > 1e-9 * period:
        raise ParameterError(
            f"its period is {controller.period!r} s",
            where="controller",
            expected=f"a whole part of the {period!r} s between setpoints",
        )
    return samples


class ControlLoop:
    """A controller, its chain and the arm.

    Parameters
    ----------
    controller : see the module.
    chain : whose encoder, converter, amplifier and delay are used; its gains are not.
    sample : time between samples [s]; steps : steps of integration in each.
    voltage_limit : at the motor [V]; gear_ratios : of the three joints, for the encoders.
    kernel : (constants, lock), as a run takes them.

    ``late`` is the delay of the plant's input, None without one.
    """

    def __init__(
        self,
        controller: Controller,
        chain: ServoConfig,
        sample: float,
        steps: int,
        voltage_limit: float,
        gear_ratios,
        kernel,
    ):
        self.controller = controller
        table = chain.table(sample, voltage_limit, gear_ratios)
        self._limit, self._amplifier = table[3], table[6]
        self._converter_step, self._delay = table[5], int(table[8])
        self._encoder_steps = table[4::SERVO_WIDTH]
        self._sample = sample
        self._kernel = kernel
        width = WIDE_ROW if kernel[0].active & WIDE else ROW
        self._rows, self._pieces = HeldRows(1, width), HeldRows(2, width)
        self._count, self._step = steps, sample / steps
        self.late: SampledDelay | None = None
        self.reset()

    def reset(self, held_voltage=(0.0, 0.0, 0.0)) -> None:
        """Forget the past; held_voltage [V] is what a delay gives before the first sample."""
        self.controller.reset()
        self._late = [tuple(float(v) for v in held_voltage)] * self._delay

    def run(self, state: State, setpoints, samples: int, start: float, out, volts) -> int:
        """Run from a state; each row of setpoints (n, 3) [rad] acts for `samples`.

        start : time of the first sample [s]. Fills out (n * samples + 1, ROW or WIDE_ROW), a row a
        sample, and volts (n * samples, 3) as asked for. Returns the first row of `out` that is not
        finite, or -1.
        """
        out[0, :12] = *state.x, *state.z[:3]
        if out.shape[1] > ROW:
            out[0, ROW:] = *state.m, *state.z[3:]
        sensed, row = self._kernel[0].active & SENSED, 0
        for setpoint in setpoints:
            setpoint = tuple(float(value) for value in setpoint)
            for _ in range(samples):
                seen = state.m if sensed else state.x
                asked = self._voltages(start + self._sample * row, setpoint, seen)
                time = start + row * (self._count * self._step)
                end = None if asked is None else self._advance(state, time, asked)
                if end is None:
                    return row + 1
                volts[row] = asked
                row += 1
                out[row] = end
                state = unpacked(end)
        return -1

    def _voltages(self, t, setpoint, seen):
        """Commanded motor voltages [V], or None where the controller's are not finite."""
        measured = tuple(_quantised(q, step) for q, step in zip(seen, self._encoder_steps))
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

    def _advance(self, state: State, time, volts):
        """The row at the end of one sample with the voltages held; None where it is not finite."""
        if self.late is None:
            return self._rows.run(state, time, ([volts], [self._count], [self._step]), self._kernel)
        return self._pieces.run(state, time, (self.late.take(volts), self.late.counts, self.late.steps), self._kernel)


class HeldRows:
    """A few rows of voltages at a time through `runs.run_voltages`, for callers that go on after
    each; width : numbers of a row of its output."""

    def __init__(self, rows: int, width: int):
        compiled = BACKEND == "numba"
        self._rows = Rows(
            np.zeros((rows, 3)) if compiled else [[0.0] * 3 for _ in range(rows)],
            np.zeros(rows) if compiled else [0.0] * rows,
            np.zeros(rows, dtype=np.int64) if compiled else [0] * rows,
            np.zeros(rows) if compiled else [0.0] * rows,
        )
        self._out = np.empty((rows + 1, width))

    def run(self, state: State, time: float, held, kernel):
        """The row at the end, or None where the state is not finite.

        held : (volts, counts, steps): triples [V], each held for `counts` steps of `steps` seconds.
        kernel : (constants, lock).
        """
        volts, counts, steps = held
        for r, row in enumerate(volts):
            for j in range(3):
                self._rows.voltage[r][j] = row[j]
            self._rows.time[r], self._rows.count[r], self._rows.step[r] = time, counts[r], steps[r]
            time += counts[r] * steps[r]
        try:
            bad = run_voltages(state, self._rows, *kernel, self._out)
        except (OverflowError, ValueError, ZeroDivisionError):
            # plain Python tells some numbers that are not finite by an exception
            return None
        return None if bad >= 0 else self._out[-1]


def unpacked(row) -> State:
    """The state in a row of a run's output."""
    values = tuple(row.tolist())
    if len(values) == ROW:
        return State(values[:9], (*values[9:], *values[:6], *AT_REST[9:]), values[:3])
    return State(values[:9], (*values[9:12], *values[15:]), values[12:15])
