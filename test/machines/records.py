# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Draws of a machine with what it lacks, and their logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from puma_sim_core.dynamics.laws import SENSED
from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.errors import PumaSimError
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

#: greatest distance of a true parameter from its start value, in deviations of its prior
FARTHEST = 1.2
#: effects beside dry friction, or in its place
OTHERS = (
    *("load_dependent_friction", "asymmetric_coulomb_friction", "stribeck_friction", "position_dependent_friction"),
    *("quadratic_friction", "input_delay", "sensor_lag", "backlash", "joint_elasticity", "joint_spring", "soft_stop"),
    *("voltage_dead_band", "voltage_offset", "voltage_saturation", "impulse", "payload", "torque_ripple"),
    *("transmission_error", "sensor_nonlinearity"),
)
#: shares of records with nothing missing, with dry friction alone, beside another effect, and with that alone
SHARES = {"nothing": 0.12, "friction": 0.25, "friction and another": 0.43, "another": 0.2}
#: of a servo inside the drive: its periods within a row
_WITHIN = 10


@dataclass(frozen=True)
class Machine:
    """How a mechanism is moved and read: rows every `step` [s] for `seconds`, by an encoder of steps `quantum` [rad or
    m]; band [Hz] of the controller, 0 with a servo in the drive; greatest speed of the motion, its amplitude and where
    its middle may be [rad or m]; hanging : joints without a drive, and where these begin."""

    step: float
    seconds: float
    quantum: float
    band: float
    speed: float
    amplitude: float
    middle: tuple[float, float] = (-0.3, 0.3)
    hanging: tuple[tuple[int, float], ...] = ()


#: as the measured logs of these machines are
MACHINES = {
    "pendulum": Machine(5e-3, 8.0, 1.534e-3, 2.0, 3.0, 1.2),
    "slide": Machine(2e-3, 12.0, 5e-6, 2.5, 0.15, 0.1, (0.1, 0.1)),
    "dfki_pendulum": Machine(2e-3, 8.0, 2e-4, 1.5, 3.0, 2.5),
    "qube_pendulum": Machine(4e-3, 10.0, 3.07e-3, 1.5, 3.0, 1.0, hanging=((1, float(np.pi)),)),
    "so101_rotation": Machine(2e-2, 40.0, 1.534e-3, 0.0, 0.6, 1.0),
    "so101_pitch": Machine(2e-2, 40.0, 1.534e-3, 0.0, 0.5, 0.8),
    "dfki_double_a0": Machine(5e-3, 12.0, 1.5e-4, 1.2, 2.5, 1.0),
}


class Record:
    """The record of a seed: its machine (`name`, or the one of the seed), true parameters and effects."""

    def __init__(self, seed: int, name: str | None = None):
        self.seed = seed
        self.name = list(MACHINES)[seed % len(MACHINES)] if name is None else name
        self.machine, self.mechanism = MACHINES[self.name], load_mechanism(self.name)
        rng = np.random.default_rng([seed, 31])
        self.theta = self._parameters(rng)
        self.goal = self._goals(rng)
        kinds = list(SHARES)
        self.kind = kinds[rng.choice(len(kinds), p=list(SHARES.values()))]
        #: noise of a row's input and of a slow disturbance, in the torque scale
        self.noise, self.disturbance = rng.uniform(0.02, 0.1), rng.uniform(0.02, 0.08)
        self.effects = self._effects(rng)

    @property
    def driven(self) -> list[int]:
        """Joints (0-based) with a drive."""
        hanging = {joint for joint, _ in self.machine.hanging}
        return [j for j in range(self.mechanism.joints) if j not in hanging]

    @cached_property
    def inertia(self) -> np.ndarray:
        """(J,) at each joint [kg.m^2 or kg], along the motion."""
        m = self.mechanism
        return m.inertia(m.start, self.goal[::50]).mean(axis=0) + m.drive(m.start).motor_inertia

    def write(self, folder: Path) -> Path:
        """The log as a CSV file."""
        inputs, positions = self._run(self.effects)
        servo = "voltage" if self.machine.band else "setpoint"
        names = [f"{kind}{j + 1}" for kind in (servo, "position") for j in range(self.mechanism.joints)]
        path = Path(folder) / f"{self.name}_{self.seed}.csv"
        table = np.column_stack([self._time, inputs, positions])
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(["time", *names]), comments="")
        return path

    @property
    def _time(self) -> np.ndarray:
        return self.machine.step * np.arange(round(self.machine.seconds / self.machine.step))

    def _parameters(self, rng) -> np.ndarray:
        """(p,) true parameters, within their priors, of a machine that can be."""
        m = self.mechanism
        while True:
            far = np.clip(0.8 * rng.standard_normal(len(m.start)), -FARTHEST, FARTHEST)
            theta = m.clip(m.start + far * m.deviations)
            try:
                m.plant(theta)
                return theta
            except PumaSimError:
                continue

    def _goals(self, rng) -> np.ndarray:
        """(n, J) where a controller leads the joints [rad or m]."""
        machine, hanging = self.machine, dict(self.machine.hanging)
        goals = np.empty((len(self._time), self.mechanism.joints))
        for j in range(self.mechanism.joints):
            if j in hanging:
                goals[:, j] = hanging[j]
                continue
            shape = (_sines, _holds, _triangles)[rng.integers(3)](rng, self._time, machine)
            width = max(2, round(0.05 / machine.step))
            shape = np.convolve(np.r_[np.full(width, shape[0]), shape], np.ones(width) / width, "valid")[1:]
            shape *= machine.amplitude * rng.uniform(0.5, 1.0) / np.abs(shape).max()
            fast = np.quantile(np.abs(np.diff(shape)) / machine.step, 0.95)
            goals[:, j] = rng.uniform(*machine.middle) + shape * min(1.0, machine.speed / fast)
        return goals

    def _effects(self, rng) -> tuple[Effect, ...]:
        """Dry friction of all driven joints, another effect on one of them, both, or none."""
        joint, another = int(rng.choice(self.driven)), "another" in self.kind
        while True:
            other = str(rng.choice(OTHERS))
            # a joint has one law of dry friction
            rubs = self.kind.startswith("friction") and not (another and KINDS[other].dry)
            effects = [self.drawn(rng, j, "coulomb_friction") for j in self.driven] if rubs else []
            try:
                return (*effects, self.drawn(rng, joint, other, tuple(effects))) if another else tuple(effects)
            except PumaSimError:
                continue  # the machine cannot have it, such as backlash without a rotor

    def drawn(self, rng, joint: int, name: str, beside: tuple[Effect, ...] = ()) -> Effect:
        """An effect on a joint (0-based) beside others, of a size that machines have. Raises ParameterError where this
        one cannot have it."""
        return _Draw(self, rng, joint).effect(name, beside)

    def _run(self, effects: tuple[Effect, ...]) -> tuple[np.ndarray, np.ndarray]:
        """(n, J) inputs as they are logged, and positions as they are read."""
        machine, m, goals = self.machine, self.mechanism, self.goal
        rng, drive = np.random.default_rng([self.seed, 32]), m.drive(m.start)
        simulator = Simulator(m.plant(self.theta, effects))
        simulator.reset(goals[0])
        axes, driven = np.array(simulator.plant.axes), np.isin(np.arange(m.joints), self.driven)
        unit = np.asarray(m.torque_scale) * drive.volts_per_torque * driven
        kept, slow = np.exp(-machine.step / 0.2), np.zeros(m.joints)
        inputs, positions = np.zeros((2, *goals.shape))
        band, velocity, last = 2.0 * np.pi * machine.band, np.zeros(m.joints), None
        for k, goal in enumerate(goals):
            read = _seen(simulator)[axes] + 0.2 * machine.quantum * rng.standard_normal(m.joints)
            positions[k] = machine.quantum * np.round(read / machine.quantum)
            slow = kept * slow + np.sqrt(1.0 - kept**2) * self.disturbance * rng.standard_normal(m.joints)
            disturbed = unit * (self.noise * rng.standard_normal(m.joints) + slow)
            if not machine.band:
                inputs[k] = goal
                for _ in range(_WITHIN):
                    volts = _servo_volts(m, goal, _seen(simulator)[axes]) + disturbed
                    simulator.step(volts, machine.step / _WITHIN)
                continue
            last = positions[k] if last is None else last
            velocity += 0.4 * ((positions[k] - last) / machine.step - velocity)
            last, ahead = positions[k], (goals[min(k + 1, len(goals) - 1)] - goal) / machine.step
            torque = self.inertia * (band**2 * (goal - positions[k]) + 1.4 * band * (ahead - velocity))
            inputs[k] = driven * (drive.volts_per_torque * torque + drive.emf * ahead)
            simulator.step(inputs[k] + disturbed, machine.step)
        return inputs, positions

    def greatest_volts(self, effects: tuple[Effect, ...], joint: int, share: float) -> float:
        """The voltage [V] at a joint that a share of the rows stays below, without a limit."""
        inputs, positions = self._run(effects)
        if not self.machine.band:
            inputs = np.array([_servo_volts(self.mechanism, *row) for row in zip(inputs, positions)])
        return float(np.quantile(np.abs(inputs[:, joint]), share))


@dataclass(frozen=True)
class _Draw:
    """Draws of the sizes of effects on a joint (0-based) of a record: such as machines have (`Mechanism.plausible`)."""

    record: Record
    rng: np.random.Generator
    joint: int

    def effect(self, name: str, beside: tuple[Effect, ...] = ()) -> Effect:
        kind = KINDS[name]
        values = {p.name: p.default for p in kind.parameters if p.default is not None} | self._values(name, beside)
        joint = None if name in ("input_delay", "payload") else self.joint + 1
        made = self.record.mechanism.plant(self.record.theta, (Effect(kind, joint, values),))
        return made.effects[-1]

    def size(self, name: str, parameter: str, least: float = 0.1) -> float:
        """Evenly in its logarithm, from a share of the greatest that machines have, or their least."""
        record = self.record
        span = record.mechanism.plausible(KINDS[name].parameter(parameter), self.joint, record.machine.step)
        assert span is not None
        return float(np.exp(self.rng.uniform(np.log(max(span[0], least * span[1])), np.log(span[1]))))

    def damping(self, name: str, stiffness: float, most: float) -> float:
        """Of a spring before the joint's inertia [N.m.s/rad], up to a share of the critical one, as the law allows."""
        critical = 2.0 * np.sqrt(stiffness * self.record.inertia[self.joint])
        return min(float(self.rng.uniform(0.05, most) * critical), KINDS[name].parameter("damping").high)

    def _values(self, name: str, beside: tuple[Effect, ...]) -> dict[str, float]:
        rng, record, u = self.rng, self.record, self.rng.uniform
        scale = float(record.mechanism.torque_scale[self.joint])
        goal, row = record.goal[:, self.joint], record.machine.step
        sign = float(rng.choice([-1.0, 1.0]))
        if name == "asymmetric_coulomb_friction":
            low, more = u(0.4, 1.2), u(1.3, 1.8)
            levels = [scale * low, scale * low * more]
            return dict(zip(("positive", "negative"), levels if sign > 0.0 else levels[::-1]))
        if name == "position_dependent_friction":
            level = scale * u(0.6, 1.4)
            return {"torque": level, "amplitude": level * u(0.4, 0.8), "angle": u(-3.0, 3.0)}
        if name == "soft_stop":
            stiffness, far = self.size(name, "stiffness", 0.03), 2.0 * np.ptp(goal)
            place = np.quantile(goal, u(0.6, 0.92)) - 0.03 * np.ptp(goal)
            return {
                "upper": float(place),
                "lower": float(place - far),
                "stiffness": stiffness,
                "damping": self.damping(name, stiffness, 0.3),
            }
        if name == "joint_elasticity":
            stiffness = self.size(name, "stiffness", 0.05)
            return {"stiffness": stiffness, "damping": self.damping(name, stiffness, 0.1)}
        if name == "backlash":
            contact = KINDS[name].parameter("stiffness")
            stiffness = min(max(20.0 * self.size("joint_elasticity", "stiffness"), contact.low), contact.high)
            gap, damping = self.size(name, "gap", 0.3), self.damping(name, stiffness, 0.1)
            return {"gap": gap, "stiffness": stiffness, "damping": damping}
        values: dict[str, Callable[[], dict[str, float]]] = {
            "coulomb_friction": lambda: {"torque": scale * u(0.4, 1.6)},
            "load_dependent_friction": lambda: {"coefficient": u(0.1, 0.3), "transmitted": 1.0},
            "stribeck_friction": lambda: {
                "torque": scale * u(0.4, 1.0),
                "velocity": self.size(name, "velocity"),
                "sliding": scale * u(0.3, 1.0),
            },
            "quadratic_friction": lambda: {"coefficient": self.size(name, "coefficient")},
            "input_delay": lambda: {"time": u(3e-3, 10e-3) + (u(0.0, row) if row > 0.01 else 0.0)},
            "sensor_lag": lambda: {"time_constant": self.size(name, "time_constant", 0.2)},
            "joint_spring": lambda: {"stiffness": self.size(name, "stiffness"), "angle": float(goal.mean())},
            "voltage_dead_band": lambda: {"voltage": self.size(name, "voltage", 0.2)},
            "voltage_offset": lambda: {"voltage": sign * self.size(name, "voltage", 0.2)},
            "voltage_saturation": lambda: {"voltage": record.greatest_volts(beside, self.joint, u(0.6, 0.95))},
            "impulse": lambda: {
                "torque": sign * self.size(name, "torque", 0.3),
                "time": u(0.2, 0.8) * record.machine.seconds,
                "width": u(0.05, 0.25),
            },
            "payload": lambda: {"mass": self.size(name, "mass", 0.3)},
            "torque_ripple": lambda: {
                "amplitude": self.size(name, "amplitude", 0.3),
                "order": float(rng.integers(1, 12)),
                "phase": u(-3.0, 3.0),
            },
            "transmission_error": lambda: {
                "amplitude": self.size(name, "amplitude", 0.2),
                "order": float(rng.integers(1, 30)),
                "phase": u(-3.0, 3.0),
            },
            "sensor_nonlinearity": lambda: {
                "amplitude": self.size(name, "amplitude", 0.2),
                "period": self.size(name, "period"),
                "phase": u(-3.0, 3.0),
            },
        }
        return values[name]()


def _sines(rng, time: np.ndarray, machine: Machine) -> np.ndarray:
    waves = zip(rng.uniform(0.15, 0.9, 3), rng.uniform(0.3, 1.0, 3), rng.uniform(0.0, 2.0 * np.pi, 3))
    return sum(size * np.sin(2.0 * np.pi * f * time + phase) for f, size, phase in waves)


def _holds(rng, time: np.ndarray, machine: Machine) -> np.ndarray:
    """From place to place at an even speed, and rests there."""
    hold, most = rng.uniform(0.8, 2.0), machine.speed / machine.amplitude * machine.step
    places = rng.uniform(-1.0, 1.0, int(time[-1] / hold) + 2)
    out, at = np.empty(len(time)), places[0]
    for k, t in enumerate(time):
        at += float(np.clip(places[int(t / hold)] - at, -most, most))
        out[k] = at
    return out


def _triangles(rng, time: np.ndarray, machine: Machine) -> np.ndarray:
    """To and fro at an even speed, of a height that changes slowly."""
    there = 2.0 * np.abs(2.0 * ((time / rng.uniform(2.0, 5.0) + rng.uniform()) % 1.0) - 1.0) - 1.0
    return there * (0.3 + 0.7 * np.sin(0.2 * time + rng.uniform(0.0, 6.0)) ** 2)


def _seen(simulator: Simulator) -> np.ndarray:
    """Positions as the sensors give them, of the kernel's three joints."""
    return np.array(simulator.measured if simulator.constants.active & SENSED else simulator.state[:3])


def _servo_volts(mechanism: Mechanism, goal: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Voltages of the servos in the drives [V] at once."""
    servos = [s for s in mechanism.servos if s is not None]
    gain, limit = np.array([s.gain for s in servos]), np.array([s.limit for s in servos])
    return np.clip(gain * (goal - position), -limit, limit)
