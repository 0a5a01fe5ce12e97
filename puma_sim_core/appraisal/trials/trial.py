# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One trial: the plant's side of a task, which any controller can be put to, sample by sample.

A trial is a generator: it yields (time [s], setpoint (3,) [rad], measurement (3,) [rad]) and takes three voltages. An
object in this process, a process behind a pipe and a node behind topics drive it alike, in lockstep: the arm waits.
Setpoints come each 28 ms; a row of the response is a sample, or the whole part of one that is at most 28/30 ms.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from functools import lru_cache
from itertools import chain, repeat
from math import ceil, floor, pi
from typing import Any, cast

import numpy as np

from puma_sim_core.appraisal.controllers import Made
from puma_sim_core.appraisal.perturbations.drawing import Conditions
from puma_sim_core.appraisal.settings import ROWS, SETPOINT_PERIOD, VOLTAGE_LIMIT
from puma_sim_core.appraisal.tasks.library import Task
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.dynamics.laws import DELAYED, SENSED, TWO_MASS
from puma_sim_core.dynamics.runs import ROW, WIDE
from puma_sim_core.dynamics.samples import flat
from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.delay import SampledDelay, delay_of
from puma_sim_core.simulation.feedback import Controller, samples_per_period
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

#: how far a joint may be beyond its range before its trial is broken off [rad]; it has failed from the range on
_BEYOND = 0.5
_NOTHING = (0.0, 0.0, 0.0)
Triple = tuple[float, float, float]
#: what a controller is asked: time [s], setpoint and measurement [rad]
Sample = tuple[float, Triple, Triple]


@lru_cache(maxsize=256)
def _references(task: Task, rows: int) -> np.ndarray:
    """(n + 1, 3) reference at the rows of a task with so many rows a setpoint."""
    count = round(task.duration / SETPOINT_PERIOD) * rows
    return task.reference(SETPOINT_PERIOD / rows * np.arange(count + 1))


class Ending(BaseException):
    """Ends a trial out of a controller, with one of `response.ENDS`; `except Exception` does not catch it."""

    def __init__(self, end: str, why: str):
        super().__init__(why)
        self.end = end


class Trial:
    """A task under conditions, for a controller with a period.

    arm : whose wrist is judged, and whose joint ranges hold; period [s]: between samples, a whole part of 28 ms.
    limit : greatest voltage at the motors [V].

    Raises ParameterError: a period that does not fit.
    """

    def __init__(
        self, task: Task, conditions: Conditions, arm: ArmParameters, period: float, limit: float = VOLTAGE_LIMIT
    ):
        self.task, self.conditions, self.arm, self.limit = task, conditions, arm, limit
        per_setpoint = samples_per_period(cast(Controller, _Rate(period)), SETPOINT_PERIOD)
        #: rows of a sample, and of a setpoint
        self.rows = ceil(ROWS / per_setpoint)
        self.per_setpoint = self.rows * per_setpoint
        #: time between rows [s]
        self.step = SETPOINT_PERIOD / self.per_setpoint
        self.reference = _references(task, self.per_setpoint)
        self.count = len(self.reference) - 1
        self.end, self.why = "completed", ""
        self._asked: list[Triple] = []
        self._given: list[Triple] = []
        self._commands: np.ndarray | None = None
        self._done = 0
        self._kernel = flat(conditions.plant.constants)
        self._out = np.zeros((self.count + 1, self._kernel.width))
        self._start()

    def _start(self) -> None:
        """The arm at rest, its motors holding it as a brake has until now: without current."""
        simulator = Simulator(self.conditions.plant)
        simulator.reset(self.task.start)
        x, z, m = simulator.whole
        self._out[0, :ROW] = (*x, *z[:3])
        if self.conditions.plant.constants.active & WIDE:
            self._out[0, ROW:] = (*m, *z[3:])

    def fail(self, end: str, why: str) -> None:
        """End the trial for a reason: one of `response.ENDS`, and a sentence."""
        self.end, self.why = end, why

    def samples(self) -> Generator[Sample, Sequence[float], None]:
        """Ask for voltages [V] sample by sample; see the module. Ends when the trial does."""
        hold, model, table, _ = self._kernel
        out, step, rows, limit = self._out, self.step, self.rows, self.limit
        seen = ROW if self.conditions.plant.constants.active & SENSED else 0
        counts, bits = self._encoder_steps(), self.conditions.converter_bits
        quantum = 0.0 if bits is None else 2.0 * limit / 2.0**bits
        highest = limit - quantum
        disturbed = self._disturbed()
        late = _Late(self, model, table) if self.conditions.plant.constants.active & DELAYED else None
        asked, given = self._asked, self._given
        noise = self._noise()
        low, high = np.transpose(self.arm.joint_ranges)
        low, high = (low - _BEYOND).tolist(), (high + _BEYOND).tolist()
        row, every = 0, self.per_setpoint
        for setpoint in map(tuple, self.reference[:: self.per_setpoint][:-1].tolist()):
            after = row + every
            while row < after:
                q = out[row, seen : seen + 3].tolist()
                if noise is not None:
                    q = [a + b for a, b in zip(q, noise[row])]
                if counts is not None:
                    q = [floor(a / b + 0.5) * b for a, b in zip(q, counts)]
                u, v, w = yield row * step, setpoint, tuple(q)  # type: ignore[misc]
                u, v, w = float(u), float(v), float(w)
                total = u + v + w
                if total - total != 0.0:
                    self.fail("not_finite", f"voltages ({u:g}, {v:g}, {w:g}) at {row * step:.4f} s")
                    return
                asked.append((u, v, w))
                u = limit if u > limit else -limit if u < -limit else u
                v = limit if v > limit else -limit if v < -limit else v
                w = limit if w > limit else -limit if w < -limit else w
                if quantum:
                    u, v, w = (min(floor(a / quantum + 0.5) * quantum, highest) for a in (u, v, w))
                volts = (u, v, w)
                for _ in range(rows):
                    if disturbed is not None:
                        volts = disturbed.volts(row, (u, v, w))
                    given.append(volts)
                    if late is None:
                        fine = hold(model, table, out, (row, row + 1), volts, row * step, 1, step)
                    else:
                        fine = late.hold(hold, out, row, volts)
                    if not fine:
                        self._done = row
                        self.fail("diverged", f"the state is no longer finite after {row * step:.4f} s")
                        return
                    row += 1
                self._done = row
            a, b, c = out[row, :3].tolist()
            if not (low[0] < a < high[0] and low[1] < b < high[1] and low[2] < c < high[2]):
                return

    def _encoder_steps(self) -> list[float] | None:
        counts = self.conditions.encoder_counts
        if counts is None:
            return None
        return [2.0 * pi / (counts * abs(ratio)) for ratio in self.conditions.plant.gear_ratios]

    def _at_rows(self) -> np.ndarray:
        """Number of the 28/30 ms in which each row lies: what is random is drawn for these, whatever the rows are."""
        return np.minimum(np.arange(self.count) * ROWS // self.per_setpoint, self.count * ROWS // self.per_setpoint - 1)

    def _draws(self, number: int) -> np.random.Generator:
        return np.random.default_rng((*self.conditions.stream, number))

    def _noise(self) -> list[list[float]] | None:
        if not self.conditions.noise:
            return None
        places = self._at_rows()
        drawn = self._draws(1).standard_normal((int(places[-1]) + 1, 3))
        return (self.conditions.noise * drawn[places]).tolist()  # type: ignore[no-any-return]

    def _disturbed(self) -> _Disturbed | None:
        c, task = self.conditions, self.task
        return _Disturbed(self) if c.jitter or c.dropped or task.pushes or task.lost else None

    def commands(self, since: int = 0) -> np.ndarray:
        """(n, 3) voltages [V] that the plant was given, a row each `step`, from row `since` on."""
        found = self._given if self._commands is None else self._commands
        return np.array(found[since:]).reshape(-1, 3)

    @property
    def rows_given(self) -> int:
        """How many there are of `commands` so far."""
        return len(self._given)

    def response(self) -> Response:
        """What the trial has left behind so far."""
        n = self._done
        asked = np.repeat(np.array(self._asked or [_NOTHING]), self.rows, axis=0)[: max(n, 1)]
        given = np.array(self._given or [_NOTHING])[: max(n, 1)]
        return self._response(self._out[: n + 1], _held(asked, n + 1), _held(given, n + 1))

    def _response(self, out: np.ndarray, asked: np.ndarray, given: np.ndarray) -> Response:
        plant, links = self.conditions.plant, 0
        if plant.constants.active & TWO_MASS:
            links = ROW + 3
        q, qd = out[:, links : links + 3], out[:, links + 3 : links + 6] if links else out[:, 3:6]
        n, end, why = len(out), self.end, self.why
        bad = self._first_outside(q, qd)
        if bad is not None:
            n, (end, why) = bad[0] + 1, ("limit", bad[1])
        return Response(
            time=self.step * np.arange(n),
            reference=self.reference[:n],
            position=q[:n],
            velocity=qd[:n],
            voltage=asked[:n],
            applied=given[:n],
            current=out[:n, 6:9],
            voltage_limit=self.limit,
            arm=self.arm,
            end=end,
            why=why,
        )

    def _first_outside(self, q: np.ndarray, qd: np.ndarray) -> tuple[int, str] | None:
        """(row, sentence) where a joint first leaves its range, or is faster than twice what its motor can turn."""
        low, high = np.transpose(self.arm.joint_ranges)
        fastest = np.array([2.0 * self.limit / (m.back_emf * m.gear_ratio) for m in self.arm.motors])
        outside = (q < low) | (q > high)
        bad = outside | (np.abs(qd) > fastest)
        rows = np.flatnonzero(bad.any(axis=1))
        if not rows.size:
            return None
        row = int(rows[0])
        j = int(np.argmax(bad[row]))
        what = f"at {q[row, j]:.4f} rad, outside {low[j]:.4f} to {high[j]:.4f}"
        if not outside[row, j]:
            what = f"at {qd[row, j]:.4g} rad/s, more than {fastest[j]:.4g}"
        return row, f"joint {j + 1} {what}, at {row * self.step:.4f} s"

    def run(self, controller: Controller) -> Response:
        """The trial with an object in this process, which is reset first; errors of its own are the trial's end."""
        ended = driven(self.samples(), controller)
        if ended is not None:
            self.fail(*ended)
        return self.response()

    def run_compiled(self, servo: ServoConfig) -> Response | None:
        """The trial with a servo that runs in the kernel; None where the kernel has not all of its conditions.

        The bits are those of `run` with the same PID as an object.
        """
        c, plant = self.conditions, self.conditions.plant
        if not c.compiled or self.task.pushes or self.task.lost or plant.constants.active & SENSED:
            return None
        servo = ServoConfig(
            servo.gains,
            converter_bits=c.converter_bits,
            encoder_counts=c.encoder_counts,
            derivative_on_measurement=servo.derivative_on_measurement,
        )
        simulator = Simulator(plant, max_step=SERVO_PERIOD)
        simulator.reset(self.task.start)
        setpoints = self.reference[:: self.per_setpoint][:-1]
        try:
            run: Any = simulator.run_servo(setpoints, servo, period=SETPOINT_PERIOD, voltage_limit=self.limit)
        except NonFiniteStateError:
            return None
        self._commands = run.voltage[:-1]
        links = simulator.link_motion
        out = np.hstack([run.position, run.velocity, run.current])
        if links is not None:
            out = np.hstack([out, np.zeros((len(out), ROW + 3 - 9)), links])
        return self._response(out, run.voltage, run.voltage)


def driven(samples: Generator[Sample, Sequence[float], None], controller: Controller) -> tuple[str, str] | None:
    """Have a controller answer samples, as `Trial.samples` asks for them, after its reset; (end, why) where the
    controller is what ends them."""
    update, ask = controller.update, samples.send
    sample, volts = next(samples), None
    try:
        try:
            controller.reset()
        except Exception as error:
            return "refused", f"reset: {_sentence(error)}"
        while True:
            try:
                volts = update(*sample)
            except Exception as error:
                return "refused", f"update at {sample[0]:.4f} s: {_sentence(error)}"
            sample = ask(volts)
    except StopIteration:
        return None
    except Ending as ending:
        return ending.end, f"{ending}, at {sample[0]:.4f} s"
    except (TypeError, ValueError, OverflowError) as error:
        return "refused", f"update gave {_shown(volts)} at {sample[0]:.4f} s, not three numbers ({error})"


class _Rate:
    """A period, for the check of it."""

    def __init__(self, period: float):
        self.period = period


class _Disturbed:
    """The voltage of each row behind a channel that is late, loses commands, or adds a disturbance."""

    def __init__(self, trial: Trial):
        c, rows, count, step = trial.conditions, trial.rows, trial.count, trial.step
        at = np.arange(0, count, rows)
        places = trial._at_rows()[at]
        arrives = at.copy()
        if c.jitter:
            drawn = trial._draws(2).uniform(0.0, c.jitter, int(places[-1]) + 1)
            arrives += np.round(drawn[places] / step).astype(int)
        fine = np.ones(len(at), dtype=bool)
        if c.dropped:
            fine = trial._draws(3).uniform(size=int(places[-1]) + 1)[places] >= c.dropped
        newest = np.full(count, -1)
        for k in np.flatnonzero(fine & (arrives < count)).tolist():
            newest[arrives[k]] = max(newest[arrives[k]], k)
        #: number of the command that acts in each row, -1 for none
        self._acts: list[int] = np.maximum.accumulate(newest).tolist()
        self._every = rows
        self._past: list[Triple] = []
        time = step * np.arange(count)
        self._on: list[bool] = [True] * count
        for begin, after in trial.task.lost:
            self._on = (np.array(self._on) & ~((time >= begin - 1e-9) & (time < after - 1e-9))).tolist()
        pushed = np.zeros((count, 3))
        for push in trial.task.pushes:
            pushed[time >= push.start - 1e-9] += push.voltage
        self._pushed: list[list[float]] = pushed.tolist()

    def volts(self, row: int, asked: Triple) -> Triple:
        """Voltages [V] of a row; asked : those of its sample."""
        if row % self._every == 0:
            self._past.append(asked)
        acts = self._acts[row]
        u, v, w = self._past[acts] if acts >= 0 and self._on[row] else _NOTHING
        a, b, c = self._pushed[row]
        return u + a, v + b, w + c


class _Late:
    """A plant whose input is late: each row in the two parts of `SampledDelay`."""

    def __init__(self, trial: Trial, model: Any, table: Any):
        constants = trial.conditions.plant.constants
        late = SampledDelay(delay_of(constants.active, constants.table), trial.step, SERVO_PERIOD)
        self._parts = list(zip(late.counts, late.steps))
        self._held: list[Triple] = list(chain(repeat(_NOTHING, late.size)))
        self._model, self._table, self._step = model, table, trial.step

    def hold(self, hold: Any, out: np.ndarray, row: int, volts: Triple) -> bool:
        """One row from `row` on, in which `volts` are asked for."""
        self._held.append(volts)
        at, time = row, row * self._step
        for part, (count, step) in enumerate(self._parts):
            if count:
                if not hold(self._model, self._table, out, (at, row + 1), self._held[row + part], time, count, step):
                    return False
                at, time = row + 1, time + count * step
        return True


def _held(values: np.ndarray, rows: int) -> np.ndarray:
    """Rows of held values, with the last one again at the end."""
    short = rows - len(values)
    return np.vstack([values, np.repeat(values[-1:], short, axis=0)]) if short > 0 else values[:rows]


def _sentence(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _shown(value: Any) -> str:
    if hasattr(value, "__len__") and len(value) > 8:
        return f"{len(value)} values"
    return " ".join(repr(value).split())[:80]


def run_trial(trial: Trial, made: Made) -> Response:
    """The response of a trial, in the kernel where that can be."""
    found = trial.run_compiled(made.servo) if made.servo is not None else None
    return trial.run(made.controller) if found is None else found
