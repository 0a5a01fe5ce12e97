# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Margins of a controller object on the linearised arm, exactly sampled.

The arm about a pose at rest is `control.linear`: the third-order model with viscous friction and loads, its voltage
held over a sample; a delay of the input and the servo's are added exactly. Other effects are left out (`left_out`):
where they matter the margins are taken by injection (`multisine`).

The controller is asked through its own `update`. It is first run with the arm until both stand still. From there its
measurement of one joint is moved by a pulse of one sample, to both sides, and half the difference of what it answers is
its impulse response. Its state is never looked at: `realised` finds one, as few states as explain the response, the
integrators included, which no impulse response of finite length could hold. Its answer to further movements, of all
joints at any sample, is then predicted; a controller that answers otherwise is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.appraisal.margins.margins import NO_MARGINS, Margins, margins_of
from puma_sim_core.appraisal.margins.realisation import SAMPLES, LinearSystem, realised
from puma_sim_core.checks import check_numbers
from puma_sim_core.control.linear import linearised, radius, sampled
from puma_sim_core.effects import VISCOUS, Effect
from puma_sim_core.effects.base import Stage
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.delay import delay_of
from puma_sim_core.simulation.feedback import Controller
from puma_sim_core.simulation.simulator import Simulator

#: times that controller and arm are given to come to rest, one after the other [s]
SETTLE = (4.0, 12.0, 36.0)
#: they are at rest where the last tenth of it moves no joint by more than this [rad]
_AT_REST = 1e-4
#: and come to rest if that is less than this share of what moved in the tenth before the middle
_DECAYS = 0.95
#: movement of a measurement [rad]: a derivative action of 3e4 V/rad answers by 0.3 V
PULSE = 1e-5
#: greatest error of the linear system, as a share of the greatest response
_MISSED = 1e-3
#: frequencies that the loop is taken at, from the lowest [rad/s] to half the sampling rate
_LOWEST, _FREQUENCIES = 0.01, 600
#: greatest eigenvalue of a stable loop
_STABLE = 1.0 - 1e-9
_WHERE = "linear margins"


def left_out(plant: Plant) -> tuple[str, ...]:
    """Names of the effects of a plant that its linearisation does not have."""
    return tuple(effect.kind.name for effect in plant.effects if not _within(effect))


def linear_part(plant: Plant) -> Plant:
    """The plant with the effects alone that its linearisation has."""
    return replace(plant, effects=tuple(effect for effect in plant.effects if _within(effect)))


def _within(effect: Effect) -> bool:
    return effect.kind is VISCOUS or effect.kind.load is not None or effect.kind.stage == Stage.DELAYED


def linear_margins(
    plant: Plant,
    pose: ArrayLike,
    controller: Controller,
    *,
    chain: ServoConfig = ServoConfig(),
    setpoint_period: float = 0.028,
    voltage_limit: float = 40.0,
) -> tuple[Margins, Margins, Margins]:
    """Margins of the loops of the three joints about a pose (3,) [rad], which is the setpoint.

    chain : whose amplifier and delay are used; setpoint_period [s]: between setpoints, a whole number of the
    controller's periods; voltage_limit [V].

    Loops that are unstable, or do not come to rest within the last of `SETTLE`, have `NO_MARGINS`.

    Raises ParameterError: a controller that is not linear about the pose, or not the same at all samples; a period that
    does not fit.
    """
    target = check_numbers(pose, "pose", 3, _WHERE)
    if not all(motor.inductance for motor in plant.arm.motors):
        raise ParameterError("a motor without inductance", where=_WHERE, expected="the third-order model")
    plain = linear_part(plant)
    ideal = replace(chain, encoder_counts=None, converter_bits=None)
    for duration in SETTLE:
        simulator = Simulator(plain)
        simulator.reset(target)
        setpoints = np.tile(target, (round(duration / setpoint_period), 1))
        try:
            run = simulator.run_controller(
                controller, setpoints, period=setpoint_period, voltage_limit=voltage_limit, chain=ideal
            )
        except NonFiniteStateError:
            return (NO_MARGINS,) * 3
        measured: Any = run.position
        halfway, last = (np.ptp(part, axis=0).max() for part in np.array_split(measured, 10)[4::5])
        if last <= _AT_REST:
            break
        if last > _DECAYS * halfway:
            return (NO_MARGINS,) * 3
    else:
        return (NO_MARGINS,) * 3
    law = law_of(controller, target, measured[:-1])
    law = law._replace(C=law.C * chain.amplifier_gain, D=law.D * chain.amplifier_gain)
    arm = sampled_arm(plain, measured[-1], controller.period, chain.delay_samples)
    return loop_margins(arm, law, controller.period)


def law_of(controller: Controller, setpoint: Sequence[float], measured: np.ndarray) -> LinearSystem:
    """The linear system from measured positions to volts that a controller is near the last of measurements (n, 3).

    Raises ParameterError: a controller that answers to small movements of all joints by other than this system.
    """

    def answers(moved: np.ndarray) -> np.ndarray:
        """Volts (SAMPLES, 3) while a standing arm is moved by (SAMPLES, 3) [rad]."""
        controller.reset()
        seen = np.concatenate([measured, measured[-1] + moved]).tolist()
        asked = [controller.update(k * controller.period, setpoint, y) for k, y in enumerate(seen)]
        return np.array(asked[-SAMPLES:], dtype=float)

    impulse = np.empty((SAMPLES, 3, 3))
    for joint in range(3):
        pulse = np.zeros((SAMPLES, 3))
        pulse[0, joint] = PULSE
        impulse[:, :, joint] = 0.5 * (answers(pulse) - answers(-pulse)) / PULSE
    law = realised(impulse)
    # pulses at any time, of all joints at once
    moved = PULSE * np.random.default_rng(0).integers(-1, 2, (SAMPLES, 3))
    missed = np.abs(answers(moved) - answers(0.0 * moved) - law.response(moved)).max() / PULSE
    if not missed <= _MISSED * max(float(np.abs(impulse).max()), 1e-300):
        what = f"answers to small movements that a linear system misses by {missed:.3g} V/rad"
        expected = "a controller that is linear and the same at all samples, near a pose; others: by injection"
        raise ParameterError(what, where="controller", expected=expected)
    return law


def sampled_arm(plant: Plant, pose: ArrayLike, period: float, delay_samples: int = 0) -> LinearSystem:
    """The arm from volts to positions, the voltages on their way among its states.

    With a delay of T = M period + f the part f of a sample sees the voltage of M + 1 samples ago, the rest that of M.
    """
    A, B = linearised(plant, pose)
    delay = delay_of(plant.constants.active, plant.constants.table)
    whole = int(delay / period + 1e-9)
    part = max(delay - whole * period, 0.0)
    F, early = sampled(A, B, period - part)
    if part > 0.0:
        before, late = sampled(A, B, part)
        F, late = F @ before, F @ late
    else:
        late = np.zeros_like(early)
    held = whole + delay_samples
    # states: x, then the voltages of 1, 2, ... held + 1 samples ago
    size = 9 + 3 * (held + 1)
    a, b, c = np.zeros((size, size)), np.zeros((size, 3)), np.zeros((3, size))
    a[:9, :9], c[:, :3] = F, np.eye(3)
    if held:
        a[:9, 9 + 3 * (held - 1) : 9 + 3 * held] += early
    else:
        b[:9] = early
    a[:9, 9 + 3 * held : 12 + 3 * held] += late
    b[9:12] = np.eye(3)
    a[12:, 9:-3] = np.eye(size - 12)
    return LinearSystem(a, b, c, np.zeros((3, 3)))


def loop_margins(arm: LinearSystem, law: LinearSystem, period: float) -> tuple[Margins, Margins, Margins]:
    """Margins of the loops that a law (positions to volts) closes around an arm (volts to positions).

    period : of both [s]. Each loop is broken at the plant input, the others stay closed.
    """
    n, k = len(arm.A), len(law.A)
    loop = np.zeros((n + k, n + k))
    loop[:n, :n] = arm.A + arm.B @ law.D @ arm.C
    loop[:n, n:] = arm.B @ law.C
    loop[n:, :n] = law.B @ arm.C
    loop[n:, n:] = law.A
    if not radius(loop) < _STABLE:
        return (NO_MARGINS,) * 3
    # input: a voltage added to the law's; output: their sum
    b = np.vstack([arm.B, np.zeros((k, 3))])
    c = np.hstack([law.D @ arm.C, law.C])
    frequency = np.geomspace(_LOWEST, np.pi / period, _FREQUENCIES)
    z = np.exp(1j * frequency * period)[:, None, None]
    sensitivity = np.eye(3) + c @ np.linalg.solve(z * np.eye(n + k) - loop, np.broadcast_to(b, (len(z), *b.shape)))
    first, second, third = (margins_of(frequency, sensitivity[:, j, j]) for j in range(3))
    return first, second, third
