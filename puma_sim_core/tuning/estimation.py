# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Estimation of an arm's parameters from recorded motions, with intervals that hold.

A record is what section 7.1.1 could take from the PUMA: the voltages at the motors and the joint
angles, both through converters and with noise. The model is run open loop with the recorded
voltages, and its parameters are moved until its angles fit the recorded ones (output error).
Open loop, an error of a recorded voltage stays in the angle for good: the residuals are not
independent, and intervals that took them so would be far too narrow. Here the residuals are
weighted with the covariance that noise of angle and voltage give together.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares
from scipy.special import chdtrc, ndtri

from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator

#: a direction of the parameters that the records tell a million times less of than another
GREATEST_CONDITION = 1e6
#: spread allowed to the angle at the start of a record, which is only measured [rad]
START_SPREAD = 1e-3


@dataclass(frozen=True)
class Instrument:
    """What the recording adds: noise of angle [rad] and voltage [V] (standard deviations), then
    steps of the encoder's counts [rad a joint] and of the voltage's converter [V]; 0 for none."""

    angle_noise: float = 2e-4
    voltage_noise: float = 0.02
    angle_steps: Sequence[float] = (0.0, 0.0, 0.0)
    voltage_step: float = 0.0

    def angle(self, values: ArrayLike, joint: int, rng: np.random.Generator) -> np.ndarray:
        """Recorded angles of joint 1, 2 or 3 for true ones [rad]."""
        return _through(values, self.angle_noise, self.angle_steps[joint - 1], rng)

    def voltage(self, values: ArrayLike, rng: np.random.Generator) -> np.ndarray:
        """Recorded voltages for true ones [V]."""
        return _through(values, self.voltage_noise, self.voltage_step, rng)

    def angle_deviation(self, joint: int) -> float:
        """Standard deviation [rad] of noise and rounding together."""
        return float(np.hypot(self.angle_noise, self.angle_steps[joint - 1] / np.sqrt(12.0)))

    @property
    def voltage_deviation(self) -> float:
        """Standard deviation [V] of noise and rounding together."""
        return float(np.hypot(self.voltage_noise, self.voltage_step / np.sqrt(12.0)))


def _through(values: ArrayLike, noise: float, step: float, rng: np.random.Generator) -> np.ndarray:
    values = np.asarray(values) + noise * rng.standard_normal(np.shape(values))
    return np.round(values / step) * step if step > 0.0 else values


@dataclass(frozen=True)
class Record:
    """One recorded motion.

    time (n,) [s], evenly spaced; voltage (n, 3) [V], row r held to time[r + 1]; every: the angles
    were taken at each `every`-th time; angle (m, 3) [rad]; joints: those whose angles count (the
    others are locked or unused); constraints: how the joints were held; start (3,)
    [rad] and current (3,) [A]: the state from rest, as measured.
    """

    time: np.ndarray
    voltage: np.ndarray
    every: int
    angle: np.ndarray
    joints: tuple[int, ...]
    constraints: Sequence[Constraint]
    start: Sequence[float]
    current: Sequence[float] = (0.0, 0.0, 0.0)

    def simulated(self, plant: Plant) -> np.ndarray:
        """(m, 3) angles [rad] of a plant under the recorded voltages, open loop."""
        simulator = Simulator(plant, constraints=self.constraints)
        simulator.reset(self.start, None, self.current)
        angles: Any = simulator.run(self.time, self.voltage).position
        return angles[:: self.every]


@dataclass(frozen=True)
class Estimate:
    """Parameters with their covariance.

    names, values (k,), covariance (k, k); confidence of `intervals`; misfit: weighted sum of
    squares over its degrees of freedom, near 1 where model and noise are right; probability: of a
    misfit as great as this if they are right. Intervals mean nothing where that is tiny.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    misfit: float
    probability: float
    confidence: float = 0.95

    @property
    def deviations(self) -> np.ndarray:
        """(k,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def intervals(self) -> np.ndarray:
        """(k, 2) confidence intervals, each of one parameter by itself."""
        half = ndtri(0.5 + self.confidence / 2.0) * self.deviations
        return np.column_stack([self.values - half, self.values + half])

    def of(self, name: str) -> tuple[float, float, float]:
        """(value, low, high) of one parameter."""
        k = self.names.index(name)
        low, high = self.intervals[k]
        return float(self.values[k]), float(low), float(high)

    def combined(self, weights: dict[str, float], constant: float = 0.0) -> tuple[float, float, float]:
        """(value, low, high) of constant + a weighted sum of parameters."""
        w = np.array([weights.get(name, 0.0) for name in self.names])
        value = constant + float(w @ self.values)
        half = ndtri(0.5 + self.confidence / 2.0) * float(np.sqrt(w @ self.covariance @ w))
        return value, value - half, value + half


@dataclass(frozen=True)
class ServoTest:
    """How one joint is driven, the others locked.

    joint : 1, 2 or 3; servo : the digital servo that drives it; every : the angles are taken at each `every`-th
    sample; settle : periods for which the first setpoint is held before the record begins, so that it begins at
    rest; voltage_limit [V].
    """

    joint: int
    servo: ServoConfig
    every: int = 5
    settle: int = 60
    voltage_limit: float = 40.0


def record_from_servo(
    plant: Plant, setpoint: ArrayLike, test: ServoTest, instrument: Instrument, rng: np.random.Generator
) -> tuple[Record, np.ndarray]:
    """Drive one joint under the servo and record it as section 7.1.1 does.

    setpoint : (n, 3) [rad], one every 28 ms.

    Returns
    -------
    (record, true angles (m, 3) at the times of its angles).
    """
    setpoint, j, lead = np.asarray(setpoint, dtype=float), test.joint - 1, 4
    constraints = tuple(Constraint() if k == j else Constraint("hold") for k in range(3))
    simulator = Simulator(plant, constraints=constraints)
    simulator.reset(setpoint[0])
    held = np.repeat(setpoint[:1], test.settle + lead, axis=0)
    run: Any = simulator.run_servo(np.vstack([held, setpoint]), test.servo, voltage_limit=test.voltage_limit)
    first, rest = test.settle * 30, lead * 30
    true = run.position[first:]
    volts = np.zeros((len(true), 3))
    volts[:, j] = instrument.voltage(run.voltage[first:, j], rng)
    angle = true[:: test.every].copy()
    angle[:, j] = instrument.angle(angle[:, j], test.joint, rng)
    start, current = list(setpoint[0]), [0.0, 0.0, 0.0]
    start[j] = float(angle[: rest // test.every, j].mean())
    current[j] = float(volts[:rest, j].mean() / plant.arm.motors[j].resistance)
    time = run.time[first:] - run.time[first]
    record = Record(time, volts, test.every, angle, (test.joint,), constraints, tuple(start), tuple(current))
    return record, true[:: test.every]


def _whitener(record: Record, joint: int, plant: Plant, instrument: Instrument) -> np.ndarray:
    """(m, m) lower triangle W that makes one joint's residuals r independent and of spread 1: W r.

    The residual is the unknown angle of the start, what the noise of each recorded voltage moves
    (the motor as a first-order lag, with the inertia at the start), and the noise of the angle. W
    holds the innovations of the Kalman filter of that process: W' W is the inverse of the
    residuals' covariance, without a matrix to be inverted.
    """
    m = len(record.angle)
    motor = plant.arm.motors[joint - 1]
    torque = plant.torque_per_ampere[joint - 1]
    M = inertia(np.array(record.start), plant.loaded_arm)[joint - 1, joint - 1]
    slope = motor.back_emf * motor.gear_ratio + motor.resistance * plant.viscous_friction[joint - 1] / torque
    lag = motor.resistance * (M + motor.inertia) / (torque * slope) if slope > 0.0 else 1.0
    spread = instrument.voltage_deviation if record.voltage[:, joint - 1].any() else 0.0
    h = float(record.time[1] - record.time[0])
    kept = float(np.exp(-h / lag))
    step = np.array([[1.0, lag * (1.0 - kept)], [0.0, kept]])
    push = np.array([h - lag * (1.0 - kept), 1.0 - kept]) * spread / slope if spread else np.zeros(2)
    # from one recorded angle to the next
    F, Q = np.eye(2), np.zeros((2, 2))
    for _ in range(record.every):
        F, Q = step @ F, step @ Q @ step.T + np.outer(push, push)
    noise = instrument.angle_deviation(joint) ** 2
    P = np.diag([START_SPREAD**2, 0.0])
    guess = np.zeros((2, m))
    W = np.zeros((m, m))
    for k in range(m):
        variance = P[0, 0] + noise
        innovation = -guess[0]
        innovation[k] += 1.0
        W[k] = innovation / np.sqrt(variance)
        gain = P[:, 0] / variance
        guess = F @ (guess + np.outer(gain, innovation))
        P = F @ (P - np.outer(gain, gain) * variance) @ F.T + Q
    return W


def estimate(
    model: Callable[[np.ndarray], Plant],
    records: Sequence[Record],
    names: Sequence[str],
    guess: ArrayLike,
    instrument: Instrument,
    *,
    lower: ArrayLike = 0.0,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    confidence: float = 0.95,
) -> Estimate:
    """Fit the model's parameters to records.

    model : plant for a vector of parameters; guess (k,), not zero: it sets the scale of each
    parameter; lower : bound(s) of the parameters; prior : (values (k,), precision (k, k)) known
    beforehand, the precision being the inverse of a covariance, zero where nothing is known.

    Raises ParameterError: no records, a guess of zero, or records that do not tell the parameters
    apart; names those that are confounded.
    """
    guess = np.asarray(guess, dtype=float)
    if not records:
        raise ParameterError("no records", where="estimation", expected="one at least")
    if guess.shape != (len(names),) or not guess.all():
        raise ParameterError(f"guess {guess}", where="estimation", expected=f"{len(names)} numbers other than 0")
    start = model(guess)
    factors = {
        (r, j): _whitener(record, j, start, instrument) for r, record in enumerate(records) for j in record.joints
    }
    roots = None
    if prior is not None:
        # eigenvalues, since a precision of what nothing is known about is singular
        size, turn = np.linalg.eigh(np.asarray(prior[1]) * np.outer(guess, guess))
        roots = np.sqrt(np.maximum(size, 0.0))[:, None] * turn.T

    def residuals(share: np.ndarray) -> np.ndarray:
        plant = model(share * guess)
        parts = []
        for r, record in enumerate(records):
            angles = record.simulated(plant)
            for j in record.joints:
                difference = angles[:, j - 1] - record.angle[:, j - 1]
                parts.append(factors[r, j] @ difference)
        if roots is not None and prior is not None:
            parts.append(roots @ (share - np.asarray(prior[0]) / guess))
        return np.concatenate(parts)

    lower = np.broadcast_to(np.asarray(lower, dtype=float), guess.shape) / guess
    bounds = np.where(guess > 0.0, lower, -np.inf), np.where(guess > 0.0, np.inf, lower)
    # a step that is small beside the parameter and great beside the rounding of a long run
    fit = least_squares(
        residuals, np.ones(len(guess)), method="trf", diff_step=1e-4, bounds=bounds, xtol=1e-10, ftol=1e-10, gtol=1e-10
    )
    _check_distinct(fit.jac, names)
    information = cho_factor(fit.jac.T @ fit.jac)
    covariance = cho_solve(information, np.eye(len(guess))) * np.outer(guess, guess)
    freedom = len(fit.fun) - len(guess)
    total = 2.0 * fit.cost
    return Estimate(tuple(names), fit.x * guess, covariance, total / freedom, float(chdtrc(freedom, total)), confidence)


def _check_distinct(jacobian: np.ndarray, names: Sequence[str]) -> None:
    """Raise where the records do not tell the parameters apart."""
    size = np.linalg.norm(jacobian, axis=0)
    if not (size > 0.0).all():
        what = f"the records do not depend on {', '.join(n for n, s in zip(names, size) if not s > 0.0)}"
        raise ParameterError(what, where="estimation", expected="a motion that excites each parameter")
    _, values, directions = np.linalg.svd(jacobian / size, full_matrices=False)
    if values[-1] * GREATEST_CONDITION < values[0]:
        worst = np.abs(directions[-1])
        mixed = ", ".join(n for n, w in zip(names, worst) if w > 0.1 * worst.max())
        expected = "motions in which they act differently, or fewer parameters"
        raise ParameterError(f"the records do not tell {mixed} apart", where="estimation", expected=expected)


def with_gyration(plant: Plant, changes: dict[str, float]) -> Plant:
    """The plant with radii of gyration squared replaced, such as {"k3yy": 0.07} [m^2].

    Raises ParameterError: a name that is not k, a link and xx, yy or zz.
    """
    links: list[Any] = list(plant.arm.links)
    for name, value in changes.items():
        found = re.fullmatch(r"k([123])(xx|yy|zz)", name)
        if found is None:
            raise ParameterError(f"'{name}'", where="radius of gyration", expected="k1xx to k3zz")
        n, axis = int(found[1]) - 1, ("xx", "yy", "zz").index(found[2])
        k = list(links[n].gyration_squared)
        k[axis] = float(value)
        links[n] = replace(links[n], gyration_squared=tuple(k))
    return Plant(replace(plant.arm, links=tuple(links)), plant.effects, plant.torque_form)
