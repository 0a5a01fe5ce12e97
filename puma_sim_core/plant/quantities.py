# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The numbers of a mechanism file: units, meaning, which values may be, and what is taken where a file leaves one out.

One table for the reader of the files, for the file that `puma-sim mechanism new` writes, and for the documentation.
"""

from typing import NamedTuple


class Quantity(NamedTuple):
    """A number of a mechanism: its units on a joint that turns and on a slide, the first of several as the default.

    sign : "positive", "not negative" or "any"; default : None where a file must have it, or text that says what is
    taken.
    """

    units: tuple[str, ...]
    meaning: str
    sign: str = "positive"
    default: float | str | None = None
    slide: tuple[str, ...] | None = None

    def of(self, kind: str) -> tuple[str, ...]:
        """Units in a file of a kind."""
        return self.slide if kind == "slide" and self.slide is not None else self.units

    @property
    def least(self) -> float:
        """The least value that may be."""
        return {"positive": 1e-12, "not negative": 0.0}.get(self.sign, -max(map(self.greatest, self.units)))

    def greatest(self, unit: str) -> float:
        """The greatest value that may be, in a unit."""
        return _GREATEST[unit]


#: beyond what any machine has, by far: a greater number is a slip of its unit or of its exponent
_GREATEST = {
    "m/s^2": 1e3,
    "kg": 1e6,
    "m": 1e3,
    "kg.m^2": 1e9,
    "N.m.s/rad": 1e9,
    "N.s/m": 1e9,
    "1": 1e6,
    "rad/m": 1e6,
    # a thousand times more, for a command in thousandths of its unit
    "ohm": 1e9,
    "H": 1e6,
    "V": 1e9,
    "V.s/rad": 1e9,
    "V.s/m": 1e9,
    "V/rad": 1e12,
    "V/m": 1e12,
    "N.m/A": 1e9,
    "N.m/V": 1e9,
    "N/A": 1e9,
    "N/V": 1e9,
}


#: nominal friction [N.m or N] of no machine is greater, nor is a coefficient of viscous friction
GREATEST_FRICTION = 1e9
#: nor is a standard deviation a greater share of its number
GREATEST_SHARE = 100.0

#: of the machine as a whole
GRAVITY = Quantity(("m/s^2",), "pull of gravity; 0 for joints that all turn about vertical axes", "not negative", 9.81)

#: of a pendulum's or a slide's body
BODY = {
    "mass": Quantity(("kg",), "mass that moves", "not negative"),
    "length": Quantity(("m",), "from the joint to the centre of mass"),
    "lever_inertia": Quantity(("kg.m^2",), "inertia about the centre of mass", "not negative", 0.0),
}
#: of a link: its frame has one axis along the link, one across it in the plane of motion (the first turned by +90
#: degrees of the joint), and one beside that plane, along the joint
LINK = {
    "mass": Quantity(("kg",), "mass", "not negative"),
    "length": Quantity(("m",), "from the shoulder to the elbow"),
    "centre": Quantity(("m",), "from the joint to the centre of mass, along the link", "any"),
    "across": Quantity(("m",), "of the centre of mass, across the link in the plane of motion", "any", 0.0),
    "beside": Quantity(("m",), "of the centre of mass, along the joint's axis from the base's axis", "any", 0.0),
    "inertia": Quantity(("kg.m^2",), "about the centre of mass, about the joint's direction", "not negative"),
    "inertia_along": Quantity(("kg.m^2",), "about the centre of mass, about the link's length", "not negative", 0.0),
    "inertia_across": Quantity(
        ("kg.m^2",), "about the centre of mass, about the direction across", "not negative", "that of inertia"
    ),
}
#: of what turns with the base alone
BASE_LINK = {
    "inertia": Quantity(("kg.m^2",), "about the vertical axis, of what turns with the base alone", "not negative")
}

_ROTOR = {
    "motor_inertia": Quantity(
        ("kg.m^2",), "rotor and gear at the joint: times the squared gear ratio", "not negative", 0.0, ("kg",)
    ),
    "viscous_friction": Quantity(("N.m.s/rad",), "viscous friction at the joint", "not negative", 0.0, ("N.s/m",)),
}
#: of a drive, by its amplifier
DRIVES: dict[str, dict[str, Quantity]] = {
    "voltage": {
        "resistance": Quantity(("ohm",), "of the winding and the amplifier"),
        "inductance": Quantity(("H",), "of the winding; 0 where L/R is negligible", "not negative", 0.0),
        "back_emf": Quantity(("V.s/rad",), "at the motor", "positive", "the torque constant"),
        "torque_constant": Quantity(("N.m/A",), "at the motor"),
        "gear_ratio": Quantity(("1",), "turns of the motor for one of the joint", "positive", 1.0, ("rad/m",)),
        **_ROTOR,
    },
    "current": {
        "gain": Quantity(("N.m/A", "N.m/V"), "torque at the joint for a unit of the command", slide=("N/V", "N/A")),
        **_ROTOR,
    },
    "torque": {
        "gain": Quantity(("1",), "torque at the joint for a unit of torque in the log", "positive", 1.0),
        **_ROTOR,
    },
    "none": _ROTOR,
}
DRIVES["position"] = {
    **DRIVES["voltage"],
    "servo_gain": Quantity(("V/rad",), "volts of the servo for a radian between goal and position", slide=("V/m",)),
    "servo_damping": Quantity(
        ("V.s/rad",), "volts of the servo against a radian a second", "not negative", 0.0, ("V.s/m",)
    ),
    "servo_limit": Quantity(("V",), "greatest volts of the servo", "positive", "no limit"),
}
#: numbers that no fit changes: a gain that is not known is in the priors of resistance and torque constant
KNOWN = ("servo_gain", "servo_damping", "servo_limit")
AMPLIFIERS = {
    "voltage": "a DC motor on voltage",
    "current": "a current-controlled drive: torque or force follows the command at once",
    "torque": "a torque-controlled drive, or a measured torque",
    "position": "a DC motor with its servo: goal positions are the input",
    "none": "no drive: the joint is passive",
}
