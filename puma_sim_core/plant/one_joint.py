# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Mechanisms of one joint: a mass on a lever (pendulum), or on a guide (slide).

    pendulum   (m l^2 + Jl + Ia) qdd + m g l sin q + H qd = torque of the drive, q = 0 hanging down
    slide      (m + Ia) qdd + H qd = force of the drive

The drive is a DC motor on voltage, whose inductance may be negligible (0), or a current-controlled
amplifier, whose torque or force follows its command in volts or amperes at once. Such a plant runs
on the kernel of the arm as its third joint, with the other two held; its link points along the
lever, and gravity down that lever at q = 0. All effects of joints work on it as on joint 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from puma_sim_core import __version__
from puma_sim_core.arm.arm import ArmParameters, Link, Motor
from puma_sim_core.effects import VISCOUS, Effect, Kind
from puma_sim_core.effects.base import ROTOR_INERTIA, SEVERAL_JOINTS, VOLTAGE_DRIVE
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.entries import Reader
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT, MechanismParameter
from puma_sim_core.plant.plant import MODEL_FORMAT, Plant, effect_mapping, effects_of_mapping, made_of_model

_UNITS = {
    "pendulum": {
        "mass": "kg",
        "length": "m",
        "lever_inertia": "kg.m^2",
        "gravity": "m/s^2",
        "resistance": "ohm",
        "inductance": "H",
        "back_emf": "V.s/rad",
        "torque_constant": "N.m/A",
        "gear_ratio": "1",
        "motor_inertia": "kg.m^2",
        "viscous_friction": "N.m.s/rad",
        "gain": ("N.m/V", "N.m/A"),
    },
    "slide": {
        "mass": "kg",
        "resistance": "ohm",
        "inductance": "H",
        "back_emf": "V.s/rad",
        "torque_constant": "N.m/A",
        "gear_ratio": "rad/m",
        "motor_inertia": "kg",
        "viscous_friction": "N.s/m",
        "gain": ("N/V", "N/A"),
    },
}
_BODY = {"pendulum": ("mass", "length", "lever_inertia", "gravity"), "slide": ("mass",)}
_DRIVE = {
    "voltage": (
        "resistance",
        "inductance",
        "back_emf",
        "torque_constant",
        "gear_ratio",
        "motor_inertia",
        "viscous_friction",
    ),
    "current": ("gain", "motor_inertia", "viscous_friction"),
}
#: what a file may leave out; without back_emf it is the torque constant, as in any DC motor
_OPTIONAL = {
    "lever_inertia": 0.0,
    "gravity": 9.81,
    "inductance": 0.0,
    "gear_ratio": 1.0,
    "motor_inertia": 0.0,
    "viscous_friction": 0.0,
    "back_emf": None,
}
_MAY_BE_ZERO = {"lever_inertia", "inductance", "motor_inertia", "viscous_friction", "mass", "gravity"}
#: L/R that a step of the kernel resolves [s]; a smaller one is negligible beside any motion here
_LEAST_LAG = 5e-4
#: units of effects on a slide for those of a turning joint
_LINEAR = {"N.m": "N", "rad": "m", "rad/s": "m/s", "N.m/rad": "N/m", "N.m.s/rad": "N.s/m", "N.m.s2/rad2": "N.s2/m2"}


@dataclass(frozen=True)
class OneJoint:
    """The numbers of a mechanism of one joint, with their priors.

    kind : "pendulum" or "slide"; amplifier : "voltage" or "current"; limits : range of the joint
    [rad or m]; torque_scale : size of a middling friction [N.m or N]; parameters : in the order of
    a file, without those that it leaves out.

    Raises
    ------
    ParameterError : numbers that no such mechanism can have.
    """

    name: str
    kind: str
    amplifier: str
    limits: tuple[float, float]
    torque_scale: float
    parameters: tuple[MechanismParameter, ...]
    sources: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self):
        v = self.values
        if not v["mass"] + v["motor_inertia"] + v.get("lever_inertia", 0.0) > 0.0:
            raise ParameterError(
                "nothing that is inert",
                where=f"mechanism '{self.name}'",
                expected="mass, motor_inertia or lever_inertia above 0",
            )
        if self.amplifier == "voltage" and 0.0 < v["inductance"] < _LEAST_LAG * v["resistance"]:
            raise ParameterError(
                f"inductance {v['inductance']:g} H with {v['resistance']:g} ohm: a time constant "
                f"of {1e3 * v['inductance'] / v['resistance']:.3g} ms",
                where=f"mechanism '{self.name}'",
                expected=f"0 where it is negligible, or L/R of {1e3 * _LEAST_LAG:g} ms or more",
            )

    @cached_property
    def values(self) -> dict[str, float]:
        """name -> value of all numbers, with those that the file leaves out."""
        return completed({p.name: p.value for p in self.parameters})

    @property
    def position_unit(self) -> str:
        return "m" if self.kind == "slide" else "rad"

    @property
    def effort_unit(self) -> str:
        return "N" if self.kind == "slide" else "N.m"

    def unit_of(self, unit: str) -> str:
        """The unit here of an effect's parameter that has `unit` on a turning joint."""
        return _LINEAR.get(unit, unit) if self.kind == "slide" else unit

    def with_values(self, values: Mapping[str, float]) -> OneJoint:
        """The mechanism with numbers replaced; priors keep their width in proportion."""
        found = []
        for p in self.parameters:
            value = float(values.get(p.name, p.value))
            share = abs(value / p.value) if p.value else 1.0
            found.append(replace(p, value=value, deviation=p.deviation * share))
        return replace(self, parameters=tuple(found))

    # ---------------------------------------------------------------------------------- files

    @classmethod
    def from_mapping(cls, mapping: Mapping, where: str | None = None) -> OneJoint:
        """From the mapping of a mechanism file.

        Raises
        ------
        ParameterError : names the key, what is wrong and what was expected.
        """
        reader = Reader(where)
        reader.keys(
            mapping, "", ("format", "name", "kind", "range", "torque_scale", "body", "drive"), optional=("format",)
        )
        kind = mapping["kind"]
        if kind not in _UNITS:
            reader.fail("kind", f"{kind!r}"[:80], "pendulum or slide")
        slide = kind == "slide"
        low, high = _range(reader, mapping["range"], "m" if slide else "rad")
        scale = reader.entry(mapping["torque_scale"], "torque_scale", "N" if slide else "N.m")
        drive = mapping["drive"]
        if not isinstance(drive, Mapping) or drive.get("amplifier") not in _DRIVE:
            found = drive.get("amplifier") if isinstance(drive, Mapping) else drive
            reader.fail("drive.amplifier", f"{found!r}"[:80], "voltage or current")
        amplifier = drive["amplifier"]
        numbers = {key: value for key, value in drive.items() if key != "amplifier"}
        parameters = [
            *_numbers(reader, mapping["body"], "body", _BODY[kind], _UNITS[kind]),
            *_numbers(reader, numbers, "drive", _DRIVE[amplifier], _UNITS[kind]),
        ]
        sources = {
            key: str(entry["source"])
            for group in (mapping["body"], numbers)
            for key, entry in group.items()
            if "source" in entry
        }
        for key in ("range", "torque_scale"):
            if "source" in mapping[key]:
                sources[key] = mapping[key]["source"]
        try:
            return cls(
                reader.text(mapping["name"], "name"),
                kind,
                amplifier,
                (low, high),
                reader.number(scale["value"], "torque_scale.value", 1e-9),
                tuple(parameters),
                sources,
            )
        except ParameterError as error:
            place = ": ".join(str(part) for part in (where, error.where) if part)
            if where is None or str(error.where or "").startswith(where):
                raise
            raise ParameterError(error.what, where=place, expected=error.expected) from None

    def to_mapping(self) -> dict:
        """The mapping of a mechanism file that loads to an equal value."""

        def entry(name, value, unit, p=None):
            result = {"value": value, "unit": unit}
            if p is not None:
                result.update({"known": True} if p.known else {"deviation": p.deviation})
            if name in self.sources:
                result["source"] = self.sources[name]
            return result

        groups = {
            key: {p.name: entry(p.name, p.value, p.unit, p) for p in self.parameters if p.name in names}
            for key, names in (("body", _BODY[self.kind]), ("drive", _DRIVE[self.amplifier]))
        }
        return {
            "format": MECHANISM_FORMAT,
            "name": self.name,
            "kind": self.kind,
            "range": entry("range", list(self.limits), self.position_unit),
            "torque_scale": entry("torque_scale", self.torque_scale, self.effort_unit),
            "body": groups["body"],
            "drive": {"amplifier": self.amplifier, **groups["drive"]},
        }


def completed(values: dict) -> dict:
    """Numbers with those that a file may leave out; real or complex."""
    if "gain" in values:
        # one ampere or volt of command is one ampere here, and gives `gain`
        values = {
            **values,
            "resistance": 1.0,
            "inductance": 0.0,
            "back_emf": 0.0,
            "torque_constant": values["gain"],
            "gear_ratio": 1.0,
        }
    values = {**_OPTIONAL, **values}
    if values["back_emf"] is None:
        values["back_emf"] = values["torque_constant"]
    return values


def _range(reader: Reader, entry, unit: str) -> tuple[float, float]:
    values = reader.entry(entry, "range", unit)["value"]
    if not isinstance(values, (list, tuple)) or len(values) != 2:
        reader.fail("range.value", f"{values!r}"[:80], "the lower and the upper end")
    low, high = (reader.number(value, "range.value") for value in values)
    if not low < high:
        reader.fail("range.value", f"from {low:g} to {high:g}", "the lower end first")
    return low, high


def _numbers(reader: Reader, group, key: str, names, units) -> list[MechanismParameter]:
    """The parameters of one group of a file."""
    reader.keys(group, key, names, optional=tuple(_OPTIONAL))
    found = []
    for name in names:
        if name not in group:
            continue
        at, unit = f"{key}.{name}", units[name]
        if not isinstance(unit, str):
            given = group[name].get("unit") if isinstance(group[name], Mapping) else None
            if given is not None and given not in unit:
                reader.fail(f"{at}.unit", f"unit '{given}'"[:80], " or ".join(unit))
            unit = given or " or ".join(unit)
        entry = reader.entry(group[name], at, unit, further=("deviation", "relative_deviation", "known"))
        low = 0.0 if name in _MAY_BE_ZERO else 1e-12
        value = reader.number(entry["value"], f"{at}.value", low)
        widths = [word for word in ("deviation", "relative_deviation", "known") if word in entry]
        if len(widths) != 1 or ("known" in entry and entry["known"] is not True):
            reader.fail(
                at,
                " and ".join(widths) or "no width of its prior",
                "one of deviation, relative_deviation or known: true",
            )
        deviation = 0.0
        if widths[0] != "known":
            deviation = reader.number(entry[widths[0]], f"{at}.{widths[0]}", 1e-12)
            deviation *= value if widths[0] == "relative_deviation" else 1.0
        if widths[0] != "known" and value == 0.0:
            reader.fail(at, "0 with a prior", "known: true, or a start above 0")
        found.append(MechanismParameter(name, unit, value, deviation, known=widths[0] == "known"))
    return found


def carrier(body: OneJoint, values: Mapping[str, float]) -> ArmParameters:
    """The arm whose third joint moves as the mechanism, with the others held at 0."""
    mass, slide = values["mass"], body.kind == "slide"
    # a slide's mass stands at a radius of 1 m, so that its inertia is the mass
    radius = 1.0 if slide else values["length"]
    heavy = mass if mass > 0.0 else 1.0
    inertia = mass * radius**2 + (0.0 if slide else values["lever_inertia"])
    # the held links have inertia too, so that the whole arm's is positive definite
    ballast = inertia + values["motor_inertia"]
    held = (Link(ballast, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), Link(ballast, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    link = Link(heavy, (0.0, 0.0, 0.0 if slide else radius * mass / heavy), (0.0, inertia / heavy, 0.0))
    motor = Motor(
        values["resistance"],
        values["inductance"],
        values["back_emf"],
        values["torque_constant"],
        values["gear_ratio"],
        values["motor_inertia"],
    )
    # with its base upside down the link hangs at q = 0
    return ArmParameters(
        body.name,
        f"mechanism '{body.name}'",
        (*held, link),
        (motor,) * 3,
        a2=0.0,
        a3=0.0,
        d3=0.0,
        d4=radius,
        gravity=0.0 if slide else -values["gravity"],
        joint_ranges=(body.limits,) * 3,
    )


def obstacle(body: OneJoint, kind: Kind) -> tuple[str, str] | None:
    """Why an effect has no meaning on a mechanism, and what was expected, or None."""
    if kind.needs is None:
        return None
    lacking = {
        SEVERAL_JOINTS: (True, f"on a {body.kind}"),
        ROTOR_INERTIA: (body.values["motor_inertia"] == 0.0, f"'{body.name}' has no motor_inertia"),
        VOLTAGE_DRIVE: (body.amplifier == "current", f"'{body.name}' has a current-controlled drive"),
    }
    lacks, words = lacking[kind.needs.what]
    return (words, kind.needs.expected) if lacks else None


@dataclass(frozen=True)
class OneJointPlant(Plant):
    """A plant of one joint; `OneJointPlant.of` makes one.

    `effects` are on joint 1, in rad and N.m, or in m and N; voltages, positions and states have
    one column. Some effects have no meaning here: see `obstacle`.

    Raises
    ------
    ParameterError : such an effect, or one on another joint.
    """

    body: OneJoint = None

    def __post_init__(self):
        for effect in self.effects:
            where, values = f"effect {effect.kind.name}", effect.on(self.arm).values
            reason = obstacle(self.body, effect.kind)
            if reason is not None:
                raise ParameterError(reason[0], where=where, expected=reason[1])
            if effect.joint not in (None, 1):
                raise ParameterError(
                    f"joint {effect.joint}", where=where, expected=f"joint=1: '{self.body.name}' has one joint"
                )
            if effect.kind.load is not None and (
                values["x"] != 0.0 or values["y"] != 0.0 or (self.body.kind == "slide" and values["z"] != 1.0)
            ):
                raise ParameterError(
                    f"beside the {self.body.kind}",
                    where=where,
                    expected="a mass alone, or z along the lever of a pendulum",
                )
        super().__post_init__()

    @classmethod
    def of(cls, body: OneJoint, effects: Iterable[Effect] = (), values: Mapping | None = None) -> OneJointPlant:
        """The plant of a mechanism; `values` replace numbers of it by name.

        Raises
        ------
        ParameterError : an effect that cannot be on it.
        """
        body = body if not values else body.with_values(values)
        return cls(carrier(body, body.values), tuple(effects), body=body)

    @property
    def joints(self) -> int:
        return 1

    @property
    def position_unit(self) -> str:
        return self.body.position_unit

    @property
    def kernel_effects(self) -> tuple[Effect, ...]:
        return tuple(e if e.joint is None else Effect(e.kind, 3, e.values) for e in self.effects)

    @cached_property
    def viscous_friction(self) -> tuple[float, float, float]:
        own = self.body.values["viscous_friction"]
        return (0.0, 0.0, own + sum(e.values["coefficient"] for e in self.effects if e.kind is VISCOUS))

    def to_mapping(self) -> dict:
        return {
            "format": MODEL_FORMAT,
            "version": __version__,
            "mechanism": self.body.to_mapping(),
            "effects": [effect_mapping(e, self.body.unit_of) for e in self.effects],
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping, where: str | None = None) -> OneJointPlant:
        """The inverse of `to_mapping`; raises ModelError as `Plant.from_mapping`."""

        def make():
            Reader(None).keys(
                mapping, "", ("format", "version", "mechanism", "effects"), optional=("version", "effects")
            )
            body = OneJoint.from_mapping(mapping["mechanism"], "mechanism")
            return cls.of(body, effects_of_mapping(mapping, body.unit_of))

        return made_of_model(make, where)
