# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm under any controller object, sample by sample.

For the interface of a controller see `Controller`. Around it stands the chain of the digital servo: encoder counts
before it; its own limit, the converter, the amplifier and the delay behind it. The positions that
it gets are the measured ones, with the plant's effects of sensing in them. With the PID
controller in it the loop gives the same bits as the servo that is compiled into the kernel.
"""

from collections.abc import Callable, Iterable, Sequence
from math import isfinite
from typing import Protocol

import numpy as np

from puma_sim_core.dynamics.laws import AT_REST, SENSED
from puma_sim_core.dynamics.runs import ROW, WIDE, WIDE_ROW, run_voltages
from puma_sim_core.dynamics.types import Constants, Rows, State
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import interpreted
from puma_sim_core.servo.servo import SERVO_WIDTH, ServoConfig, quantised
from puma_sim_core.simulation.delay import SampledDelay
from puma_sim_core.simulation.run_inputs import rows_of

_quantised: Callable[..., float] = interpreted(quantised)
#: constants of a plant and the rows that constraints take out, as a run takes them
Kernel = tuple[Constants, tuple[float, ...]]


class Controller(Protocol):
    """What the loop asks of a controller."""

    period: float

    def reset(self) -> None:
        """Forget the past."""

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> Sequence[float]:
        """Three voltages [V] at time t [s]; setpoint, measurement: three positions [rad]."""


def samples_per_period(controller: Controller, period: float, where: str = "controller") -> int:
    """Samples of the controller between two setpoints, which come each `period` [s]; where : its name in errors.

    Raises ParameterError: the period is not a whole number of the controller's own.
    """
    samples = round(period / controller.period)
    if samples < 1 or abs(samples * controller.period - period) > 1e-9 * period:
        what, expected = f"its period is {controller.period!r} s", f"a whole part of the {period!r} s between setpoints"
        raise ParameterError(what, where=where, expected=expected)
    return samples


class ControlLoop:
    """A controller, its chain and the arm.

    controller : see the module.
    chain : whose encoder, converter, amplifier and delay are used; its gains are not.
    sample : time between samples [s]; steps : steps of integration in each.
    voltage_limit : at the motor [V]; gear_ratios : of the three joints, for the encoders.
    kernel : (constants, lock), as a run takes them; late : the delay of the plant's input.
    """

    def __init__(
        self,
        controller: Controller,
        chain: ServoConfig,
        sample: float,
        steps: int,
        voltage_limit: float,
        gear_ratios: Sequence[float],
        kernel: Kernel,
        late: SampledDelay | None = None,
    ):
        self.controller = controller
        table = chain.table(sample, voltage_limit, gear_ratios)
        self._limit, self._amplifier = table[3], table[6]
        self._converter_step, self._delay = table[5], int(table[8])
        self._encoder_steps = table[4::SERVO_WIDTH]
        self._sample, self._steps = sample, steps
        self._step = steps * (sample / steps)
        self.use(kernel, late)
        self.reset()

    def use(self, kernel: Kernel, late: SampledDelay | None) -> None:
        """Go on with another kernel; the controller keeps its memory."""
        self._kernel = kernel
        self._held = HeldVoltage(kernel, self._steps, self._sample / self._steps, late)

    def reset(self, held_voltage: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Forget the past; held_voltage [V] is what a delay gives before the first sample."""
        self.controller.reset()
        self._late = [tuple(map(float, held_voltage))] * self._delay

    def run(
        self,
        state: State,
        setpoints: Iterable[Sequence[float]],
        samples: int,
        start: float,
        out: np.ndarray,
        volts: np.ndarray,
    ) -> int:
        """Run from a state; each row of setpoints (n, 3) [rad] acts for `samples`.

        start : time of the first sample [s]. Fills out (n * samples + 1, ROW or WIDE_ROW), a row a sample, and
        volts (n * samples, 3) as asked for. Returns the first row of `out` that is not finite, or -1.
        """
        out[0, :12] = *state.x, *state.z[:3]
        if out.shape[1] > ROW:
            out[0, ROW:] = *state.m, *state.z[3:]
        sensed, row = self._kernel[0].active & SENSED, 0
        for setpoint in setpoints:
            setpoint = tuple(map(float, setpoint))
            for _ in range(samples):
                seen = state.m if sensed else state.x
                asked = self._voltages(start + self._sample * row, setpoint, seen)
                end = None if asked is None else self._held.run(state, start + row * self._step, asked)
                if asked is None or end is None:
                    return row + 1
                volts[row] = asked
                row += 1
                out[row] = end
                state = unpacked(end)
        return -1

    def _voltages(self, t: float, setpoint: Sequence[float], seen: Sequence[float]) -> tuple[float, ...] | None:
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
        """The motor's voltage [V] for one of the controller's."""
        limit, step = self._limit, self._converter_step
        u = _quantised(min(max(u, -limit), limit), step)
        # the converter's highest code is one step short of its lowest, as in two's complement
        return (min(u, limit - step) if step > 0.0 else u) * self._amplifier


class HeldVoltage:
    """One sample at a time through `runs.run_voltages`, for callers that go on after each.

    kernel : (constants, lock); count : steps of integration in a sample, of `step` seconds; late : the delay of the
    plant's input.
    """

    def __init__(self, kernel: Kernel, count: int, step: float, late: SampledDelay | None):
        n, compiled = 1 if late is None else 2, type(kernel[0].table) is not list
        self._kernel, self._late = kernel, late
        self._counts, self._steps = ([count], [step]) if late is None else (late.counts, late.steps)
        count_rows, edge_rows, step_rows = (rows_of(np.zeros(n, kind), compiled) for kind in (int, float, float))
        self._rows = Rows(rows_of(np.zeros((n, 3)), compiled), edge_rows, count_rows, step_rows)
        self._out = np.empty((n + 1, WIDE_ROW if kernel[0].active & WIDE else ROW))

    def run(self, state: State, time: float, voltage: Sequence[float]) -> np.ndarray | None:
        """The row at the end of a sample with a voltage (3,) [V] held, or None where the state is not finite."""
        for r, volts in enumerate([voltage] if self._late is None else self._late.take(voltage)):
            for j in range(3):
                self._rows.voltage[r][j] = volts[j]
            count, step = self._counts[r], self._steps[r]
            self._rows.time[r], self._rows.count[r], self._rows.step[r] = time, count, step
            time += count * step
        try:
            bad = run_voltages(state, self._rows, *self._kernel, self._out)
        except (OverflowError, ValueError, ZeroDivisionError):
            # plain Python tells some numbers that are not finite by an exception
            return None
        return None if bad >= 0 else self._out[-1]


def unpacked(row: np.ndarray) -> State:
    """The state in a row of a run's output."""
    values = tuple(row.tolist())
    if len(values) == ROW:
        return State(values[:9], (*values[9:], *values[:6], *AT_REST[9:]), values[:3])
    return State(values[:9], (*values[9:12], *values[15:]), values[12:15])
