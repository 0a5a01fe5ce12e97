# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Joints of which only the transmissions are known: position sensors on both sides, and the torque of the motors.

Nothing of the links is described, so that no motion can be predicted from a torque and no plant simulated: what can be
asked is how the link follows the motor (`identify.link_side`). In a file the joints stand as `joint1`, `joint2` and so
on, each with its range, its torque scale, a drive on torque or current or none, and a sensor on the link's side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.checks import Reader
from puma_sim_core.effects import Effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.linkage.linkage_file import SENSOR, drive_numbers, link_sensor, moving
from puma_sim_core.plant.mechanism import Drive, LinkSensor, Mechanism, MechanismParameter
from puma_sim_core.plant.plant import Plant

#: most joints of a file
_MOST = 9
#: amplifiers whose torque is known without the motor's electrical numbers
AMPLIFIERS_OF_TRANSMISSIONS = ("torque", "current", "none")
_KEYS = ("range", "torque_scale", "drive", SENSOR)


@dataclass(frozen=True, eq=False)
class TransmissionMechanism(Mechanism):
    """A `Mechanism` without links; sensors : (J,); amplifiers : (J,) of `quantities.AMPLIFIERS`."""

    sensors: tuple[LinkSensor, ...] = ()
    amplifiers: tuple[str, ...] = ()

    @property
    def link_sensors(self) -> tuple[LinkSensor | None, ...]:
        return self.sensors

    @property
    def links_known(self) -> bool:
        return False

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple("" if amplifier == "none" else "voltage" for amplifier in self.amplifiers)

    def drive(self, theta: ArrayLike | None) -> Drive:
        own = {p.name: p.value for p in self.parameters}

        def column(name: str, default: float) -> np.ndarray:
            return np.array([own.get(f"joint{j}.{name}", default) for j in range(1, self.joints + 1)])

        nothing = np.zeros(self.joints)
        viscous, inertia = column("viscous_friction", 0.0), column("motor_inertia", 0.0)
        return Drive(1.0 / column("gain", 1.0), nothing, nothing, viscous, inertia, nothing + 1.0)

    def _nothing(self) -> NoReturn:
        what = "a mechanism of kind transmission, whose links are not described"
        raise ParameterError(what, where=self.name, expected="one of kind linkage, pendulum, slide or arm")

    def torque(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        self._nothing()

    def gravity(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        self._nothing()

    def inertia(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        self._nothing()

    def inertia_matrices(self, q: ArrayLike) -> Callable[[ArrayLike | None], np.ndarray]:
        self._nothing()

    def link_jacobian(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        self._nothing()

    def plant(self, theta: ArrayLike | None = None, effects: Iterable[Effect] = ()) -> Plant:
        self._nothing()

    def of_plant(self, plant: Plant) -> Mechanism:
        self._nothing()


def read_transmission(mapping: Mapping[str, Any], reader: Reader) -> TransmissionMechanism:
    """The mechanism of the mapping of a file of kind transmission.

    Raises ParameterError: names the key, what is wrong and what was expected.
    """
    names = [f"joint{j}" for j in range(1, _MOST + 1)]
    reader.keys(mapping, "", ("format", "name", "kind", *names), names)
    own = [name for name in names if name in mapping]
    missing = next((name for name in names[: max(len(own), 1)] if name not in mapping), None)
    if missing is not None:
        reader.fail(missing, "missing", "joints in order from joint1 on")
    limits, scales, amplifiers, sensors = [], list[float](), list[str](), list[LinkSensor]()
    parameters: list[MechanismParameter] = []
    for name in own:
        entry, prefix = reader.keys(mapping[name], name, _KEYS), f"{name}."
        ends, scale, amplifier = moving(reader, entry, prefix, "transmission")
        if amplifier not in AMPLIFIERS_OF_TRANSMISSIONS:
            reader.fail(f"{prefix}drive.amplifier", amplifier, " or ".join(AMPLIFIERS_OF_TRANSMISSIONS))
        for p in drive_numbers(reader, entry["drive"], f"{prefix}drive", amplifier, "transmission", prefix):
            if not p.known:
                reader.fail(f"{prefix}drive.{p.name.removeprefix(prefix)}", "a prior", "known: true: nothing is fitted")
            parameters.append(p)
        sensor = link_sensor(reader, entry, prefix, "transmission")
        assert sensor is not None  # one of the keys
        limits.append(ends)
        scales.append(scale)
        amplifiers.append(amplifier)
        sensors.append(sensor)
    return TransmissionMechanism(
        name=reader.text(mapping["name"], "name", 1),
        joints=len(own),
        position_unit="rad",
        effort_unit="N.m",
        ranges=tuple(limits),
        torque_scale=np.array(scales),
        gear=np.ones(len(own)),
        parameters=tuple(parameters),
        sensors=tuple(sensors),
        amplifiers=tuple(amplifiers),
    )
