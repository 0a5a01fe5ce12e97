# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What identification needs of a machine: parameters with priors, torques, a plant.

A `Mechanism` is an arm of three joints (`arm_mechanism`) or a part of one (`linkage_mechanism`), or joints of which
only the transmissions are known (`transmission`). The voltage that a motion takes is, joint by joint (equations 4.1
and 5.1),

    Vhat = k (1 + lag d/dt) [link torque + Ia qdd + H qd] + emf qd,   k = R / (N kt), lag = L / R.

Functions take a vector ``theta`` of the parameters that are not known, in their units, and n rows
at once. A model that already holds effects keeps them: they are in the plants, not in the torques.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    from puma_sim_core.effects import Effect
    from puma_sim_core.effects.base import Parameter
    from puma_sim_core.plant.plant import Plant

MECHANISM_FORMAT = "puma-sim mechanism 1"
#: a number that must be positive stays within this share and this multiple of its start
_LEAST_SHARE, _GREATEST_MULTIPLE = 0.1, 10.0


def linear_unit(unit: str) -> str:
    """The unit on a slide of what has `unit` on a joint that turns: rad and N.m are m and N."""
    return unit.replace("N.m", "N").replace("rad", "m")


@dataclass(frozen=True)
class MechanismParameter:
    """A number of a mechanism with its Gaussian prior.

    value and deviation (standard deviation) in `unit`; known: taken as it is, not fitted;
    positive: a fit must not let it become zero or change its sign.
    """

    name: str
    unit: str
    value: float
    deviation: float
    known: bool = False
    positive: bool = True

    @property
    def bounds(self) -> tuple[float, float]:
        """What a fit may make of it: (low, high)."""
        if self.positive:
            return _LEAST_SHARE * self.value, _GREATEST_MULTIPLE * self.value
        return -np.inf, np.inf


def complex_slope(function: Callable[[np.ndarray], Any], theta: ArrayLike, n: int) -> np.ndarray:
    """Derivative to theta[n] of what a function gives, as one array, by the complex step."""
    moved = np.array(theta, dtype=complex)
    moved[n] += 1e-30j
    return np.imag(np.asarray(function(moved))) * 1e30


class PositionServo(NamedTuple):
    """The servo inside a drive on goal positions: u = gain (goal - q) - damping dq/dt within +-limit.

    gain [V/rad]; damping [V.s/rad]; limit [V].
    """

    gain: float
    damping: float
    limit: float

    def voltage(self, time: np.ndarray, goal: np.ndarray, position: np.ndarray) -> np.ndarray:
        """(n,) mean voltage [V] from each row to the next; its position moves evenly between rows, its goal is held."""
        step = np.append(np.diff(time), 1.0)
        travel = np.append(np.diff(position), 0.0)
        volts = self.gain * (goal - position - 0.5 * travel) - self.damping * travel / step
        return np.clip(volts, -self.limit, self.limit)


class LinkSensor(NamedTuple):
    """A second position sensor of a joint, on the link's side of its transmission; its zero is arbitrary.

    resolution : the least change that it shows [rad or m].
    """

    resolution: float


class Drive(NamedTuple):
    """Constants of the drives, (J,) each, or their derivatives, (J, p) each.

    volts_per_torque : k = R / (N kt) [V per N.m or N]; lag : L / R [s]; emf : ke N [V.s/rad];
    viscous : H [N.m.s/rad]; motor_inertia : Ia at the joint [kg.m^2]; resistance : R [ohm]. With an
    amplifier that controls current or torque, and without one, lag and emf are 0, R is 1, and the "voltage" is the
    command.
    """

    volts_per_torque: np.ndarray
    lag: np.ndarray
    emf: np.ndarray
    viscous: np.ndarray
    motor_inertia: np.ndarray
    resistance: np.ndarray


#: middle of the nominal friction of the PUMA 560's joints [N.m], of it in volts and amperes, of their ranges [rad], and
#: greatest inertia in the middle of these [kg m^2]: what plausible ranges of effects are relative to
_OF_ARM = MappingProxyType({"torque": 10.0, "volts": 0.7, "current": 0.43, "range": 5.0, "inertia": 3.9})


@dataclass(frozen=True, eq=False)
class Mechanism(ABC):
    """A machine as identification sees it; see `load_mechanism`.

    name : such as "puma560"; joints : J, 1 to 3; position_unit, effort_unit : "rad" and "N.m", or "m" and "N".
    ranges : ((low, high), ...) of the joints; gear : (J,) gear ratios N, 1 where there is none.
    torque_scale : (J,) nominal friction scale, the unit of priors of effects.
    parameters : all numbers, with priors; theta holds those that are not known, in this order.
    effects : what the start model has beyond `parameters`: known structure of every plant.
    """

    name: str
    joints: int
    position_unit: str
    effort_unit: str
    ranges: tuple[tuple[float, float], ...]
    torque_scale: np.ndarray
    gear: np.ndarray
    parameters: tuple[MechanismParameter, ...]
    effects: tuple[Effect, ...] = field(default=())

    @cached_property
    def free(self) -> tuple[MechanismParameter, ...]:
        """The parameters that theta holds, (p,)."""
        return tuple(p for p in self.parameters if not p.known)

    @cached_property
    def start(self) -> np.ndarray:
        """(p,) theta of the start values."""
        return np.array([p.value for p in self.free])

    @cached_property
    def deviations(self) -> np.ndarray:
        """(p,) standard deviations of the prior of theta."""
        return np.array([p.deviation for p in self.free])

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds (p,) of theta."""
        low, high = zip(*(p.bounds for p in self.free)) if self.free else ((), ())
        return np.array(low, dtype=float), np.array(high, dtype=float)

    def clip(self, theta: ArrayLike) -> np.ndarray:
        """(p,) theta within its bounds."""
        return np.clip(np.asarray(theta, dtype=float), *self.bounds)

    def values(self, theta: ArrayLike | None = None) -> dict[str, Any]:
        """name -> value of all parameters; those of theta may be complex."""
        result = {p.name: p.value for p in self.parameters}
        if theta is not None:
            theta = np.asarray(theta)
            if theta.shape != (len(self.free),):
                raise ParameterError(f"theta of shape {theta.shape}", where=self.name, expected=f"({len(self.free)},)")
            result.update(zip((p.name for p in self.free), theta.tolist()))
        return result

    @abstractmethod
    def torque(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """(n, J) torque D qdd + C + G of the links, without the motors' inertia and friction."""

    @abstractmethod
    def gravity(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        """(n, J) gravity torque G."""

    @abstractmethod
    def inertia(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        """(n, J) diagonal of D."""

    def inertia_matrix(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        """(n, J, J) D of the links."""
        return self.inertia_matrices(q)(theta)

    @abstractmethod
    def inertia_matrices(self, q: ArrayLike) -> Callable[[ArrayLike | None], np.ndarray]:
        """theta -> `inertia_matrix` at the same positions: what of it does not depend on theta is made once."""

    def gravity_tilt(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray | None:
        """(n, J, 2) change of G per rad of tilt of the base about x and y, or None."""
        return None

    def payload_torque(
        self, theta: ArrayLike | None, at: tuple[float, float, float], q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
    ) -> np.ndarray | None:
        """(n, J) torque that 1 kg at a place of the last link takes, (x, y, z) [m] in its frame, or None."""
        return None

    @abstractmethod
    def link_jacobian(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """(n, J, p) derivative of `torque`."""

    @abstractmethod
    def drive(self, theta: ArrayLike | None) -> Drive:
        """Constants of the drives, (J,) each."""

    @abstractmethod
    def plant(self, theta: ArrayLike | None = None, effects: Iterable[Effect] = ()) -> Plant:
        """The plant to simulate, with the mechanism's own effects and further ones."""

    def possible(self, name: str, joint: int | None = None) -> bool:
        """Whether an effect of this name has a meaning on a joint (1-based, None: anywhere); plants refuse others."""
        return True

    @property
    def inputs(self) -> tuple[str, ...]:
        """(J,) the channel of a log with each joint's input: "voltage", "setpoint" where a servo in the drive makes the
        voltage of it, or "" of a joint without a drive, which is passive."""
        return ("voltage",) * self.joints

    @property
    def driven(self) -> tuple[bool, ...]:
        """(J,) whether each joint has a drive."""
        return tuple(channel != "" for channel in self.inputs)

    @property
    def servos(self) -> tuple[PositionServo | None, ...]:
        """(J,) the servo in each drive, None where there is none."""
        return (None,) * self.joints

    @property
    def link_sensors(self) -> tuple[LinkSensor | None, ...]:
        """(J,) the second position sensor of each joint, on the link's side; None where there is none."""
        return (None,) * self.joints

    @property
    def links_known(self) -> bool:
        """Whether the rigid body is described, so that torques have a meaning and a plant can be simulated."""
        return True

    @property
    def library_sized(self) -> bool:
        """Whether the sizes and priors of the library's tables, which are of the PUMA 560, are this machine's own."""
        return False

    @abstractmethod
    def of_plant(self, plant: Plant) -> Mechanism:
        """This mechanism with a plant's numbers and effects as its start, the widths of the priors in proportion.

        Raises ParameterError: a plant of another kind.
        """

    def unit(self, unit: str) -> str:
        """Unit of an effect's parameter on this mechanism."""
        return unit if self.position_unit == "rad" else linear_unit(unit)

    def effect_scale(self, unit: str, joint: int) -> float | None:
        """How large effects of this machine are beside those of the PUMA 560, in whose sizes the library's plausible
        ranges are given, for parameters of a unit at a joint (0-based); None for a unit that no scale is known of.

        Torques go with the nominal friction, angles with the range (a turn at most), masses with the inertia.
        """
        low, high = self.ranges[joint]
        torque = float(self.torque_scale[joint]) / _OF_ARM["torque"]
        angle = min(high - low, 2.0 * np.pi if self.position_unit == "rad" else np.inf) / _OF_ARM["range"]
        drive = self.drive(self.start)
        volts = float(drive.volts_per_torque[joint] * self.torque_scale[joint])
        if unit in ("A", "1/A"):
            current = volts / float(drive.resistance[joint]) / _OF_ARM["current"]
            return current if unit == "A" else 1.0 / current
        if unit == "kg":
            middle = np.array([[0.5 * (max(a, -np.pi) + min(b, np.pi)) for a, b in self.ranges]])
            return float(self.inertia(self.start, middle)[0].max()) / _OF_ARM["inertia"]
        scales = {"1": 1.0, "s": 1.0, "V": volts / _OF_ARM["volts"], "rad": angle, "rad/s": angle}
        scales |= {"N.m": torque, "N.m/rad": torque / angle, "N.m.s2/rad2": torque / angle**2}
        return scales.get(unit)

    def plausible(self, parameter: Parameter, joint: int | None, period: float = 0.0) -> tuple[float, float] | None:
        """(least, greatest) size of an effect's parameter on a machine like this one: the library's range, times
        `effect_scale`.

        joint : 0-based, None for an effect of the whole arm, which may have what it may have at any joint; period : of
        the log [s], by which a time may be longer where the parameter says so. None: no range is known.
        """
        if parameter.plausible is None:
            return None
        joints = range(self.joints) if joint is None else (joint,)
        scales = [scale for j in joints if (scale := self.effect_scale(parameter.unit, j)) is not None]
        if not scales:
            return None
        low, high = parameter.plausible
        return low * min(scales), high * max(scales) + parameter.periods * period

    def total_torque(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """(n, J) all that the motors must give: `torque` + Ia qdd + H qd."""
        drive = self.drive(theta)
        return self.torque(theta, q, qd, qdd) + drive.motor_inertia * qdd + drive.viscous * qd

    def model_voltage(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """(n, J) Vhat without its lag term: k * total torque + emf qd."""
        drive = self.drive(theta)
        return drive.volts_per_torque * self.total_torque(theta, q, qd, qdd) + drive.emf * np.asarray(qd)

    def position_gradient(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """(n, J, J) change of `torque` of joint i per rad (m) of joint j, by differences."""
        q = np.asarray(q, dtype=float)
        columns = [
            (self.torque(theta, q + step, qd, qdd) - self.torque(theta, q - step, qd, qdd)) / 2e-5
            for step in 1e-5 * np.eye(self.joints)
        ]
        return np.stack(columns, axis=-1)

    def drive_jacobian(self, theta: ArrayLike | None) -> Drive:
        """Derivatives (J, p) of the constants of the drives, by complex step."""
        theta = self.start if theta is None else theta
        columns = [complex_slope(self.drive, theta, n) for n in range(len(self.free))]
        none = np.zeros((len(Drive._fields), self.joints, 0))
        return Drive(*(np.stack(columns, axis=-1) if columns else none))

    def torque_jacobian(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """(n, J, p) derivative of `total_torque`."""
        slopes = self.drive_jacobian(theta)
        result = self.link_jacobian(theta, q, qd, qdd)
        result += np.asarray(qdd)[:, :, None] * slopes.motor_inertia
        result += np.asarray(qd)[:, :, None] * slopes.viscous
        return result
