# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Mechanisms of one joint: a mass on a lever (pendulum), or on a guide (slide).

    pendulum   (m l^2 + Jl + Ia) qdd + m g l sin q + H qd = torque of the drive, q = 0 hanging down
    slide      (m + Ia) qdd + H qd = force of the drive

The drive is a DC motor on voltage, whose inductance may be negligible (0), or a current-controlled
amplifier, whose torque or force follows its command in volts or amperes at once. Such a plant runs
on the kernel of the arm as its third joint, with the other two held; its link points along the
lever, and gravity down that lever at q = 0. All effects of joints work on it as on joint 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from puma_sim_core import __version__
from puma_sim_core.arm.arm import ArmParameters, Link, Motor
from puma_sim_core.checks import Reader
from puma_sim_core.effects import VISCOUS, Effect, Kind
from puma_sim_core.effects.base import ROTOR_INERTIA, SEVERAL_JOINTS, VOLTAGE_DRIVE
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT, MechanismParameter, linear_unit
from puma_sim_core.plant.plant import MODEL_FORMAT, Plant, effect_mapping, effects_of_mapping, made_of_model

#: units of a file, the first of several as the default
_PENDULUM: dict[str, tuple[str, ...]] = {
    "mass": ("kg",),
    "length": ("m",),
    "lever_inertia": ("kg.m^2",),
    "gravity": ("m/s^2",),
    "resistance": ("ohm",),
    "inductance": ("H",),
    "back_emf": ("V.s/rad",),
    "torque_constant": ("N.m/A",),
    "gear_ratio": ("1",),
    "motor_inertia": ("kg.m^2",),
    "viscous_friction": ("N.m.s/rad",),
    "gain": ("N.m/V", "N.m/A"),
}
_SLIDE = {"gear_ratio": ("rad/m",), "motor_inertia": ("kg",), "viscous_friction": ("N.s/m",), "gain": ("N/V", "N/A")}
_UNITS = {"pendulum": _PENDULUM, "slide": _PENDULUM | _SLIDE}
_BODY = {"pendulum": ("mass", "length", "lever_inertia", "gravity"), "slide": ("mass",)}
_MOTOR = ("resistance", "inductance", "back_emf", "torque_constant", "gear_ratio")
_ROTOR = ("motor_inertia", "viscous_friction")
_DRIVE = {"voltage": _MOTOR + _ROTOR, "current": ("gain", *_ROTOR)}
#: what a file may leave out; without back_emf it is the torque constant, as in any DC motor
_OPTIONAL: dict[str, Any] = {
    **dict.fromkeys(("lever_inertia", "inductance", "motor_inertia", "viscous_friction"), 0.0),
    "gravity": 9.81,
    "gear_ratio": 1.0,
    "back_emf": None,
}
_MAY_BE_ZERO = {"lever_inertia", "inductance", "motor_inertia", "viscous_friction", "mass", "gravity"}
_WIDTHS = ("deviation", "relative_deviation", "known")
#: L/R that a step of the kernel resolves [s]; a smaller one is negligible beside any motion here
_LEAST_LAG = 5e-4


@dataclass(frozen=True)
class OneJoint:
    """The numbers of a mechanism of one joint, with their priors.

    kind : "pendulum" or "slide"; amplifier : "voltage" or "current"; limits : range of the joint
    [rad or m]; torque_scale : nominal friction [N.m or N]; parameters : in the order of
    a file, without those that it leaves out.

    Raises ParameterError: numbers that no such mechanism can have.
    """

    name: str
    kind: str
    amplifier: str
    limits: tuple[float, float]
    torque_scale: float
    parameters: tuple[MechanismParameter, ...]
    sources: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        v, where = self.values, f"mechanism '{self.name}'"
        if not v["mass"] + v["motor_inertia"] + v.get("lever_inertia", 0.0) > 0.0:
            expected = "mass, motor_inertia or lever_inertia above 0"
            raise ParameterError("nothing that is inert", where=where, expected=expected)
        if self.amplifier == "voltage" and 0.0 < v["inductance"] < _LEAST_LAG * v["resistance"]:
            lag = f"a time constant of {1e3 * v['inductance'] / v['resistance']:.3g} ms"
            what = f"inductance {v['inductance']:g} H with {v['resistance']:g} ohm: {lag}"
            expected = f"0 where it is negligible, or L/R of {1e3 * _LEAST_LAG:g} ms or more"
            raise ParameterError(what, where=where, expected=expected)

    @cached_property
    def values(self) -> dict[str, float]:
        """name -> value of all numbers, with those that the file leaves out."""
        return completed({p.name: p.value for p in self.parameters})

    def unit_of(self, unit: str) -> str:
        """The unit here of an effect's parameter that has `unit` on a turning joint."""
        return linear_unit(unit) if self.kind == "slide" else unit

    def with_values(self, values: Mapping[str, float]) -> OneJoint:
        """The mechanism with numbers replaced; priors keep their width in proportion."""

        def moved(p: MechanismParameter) -> MechanismParameter:
            value = float(values.get(p.name, p.value))
            return replace(p, value=value, deviation=p.deviation * (abs(value / p.value) if p.value else 1.0))

        return replace(self, parameters=tuple(map(moved, self.parameters)))

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str | None = None) -> OneJoint:
        """From the mapping of a mechanism file.

        Raises ParameterError: names the key, what is wrong and what was expected.
        """
        reader = Reader(where)
        names = ("format", "name", "kind", "range", "torque_scale", "body", "drive")
        reader.keys(mapping, "", names, optional=("format",))
        kind = reader.choice(mapping["kind"], "kind", _UNITS)
        rad, effort = ("m", "N") if kind == "slide" else ("rad", "N.m")
        low, high = reader.numbers(reader.entry(mapping["range"], "range", rad)["value"], "range.value", 2)
        if not low < high:
            reader.fail("range.value", f"from {low:g} to {high:g}", "the lower end first")
        scale = reader.quantity(mapping["torque_scale"], "torque_scale", effort, 1e-9)
        drive = mapping["drive"]
        found = drive.get("amplifier") if isinstance(drive, Mapping) else drive
        amplifier = reader.choice(found, "drive.amplifier", _DRIVE)
        motor = {key: value for key, value in drive.items() if key != "amplifier"}
        parameters = (
            *_numbers(reader, mapping["body"], "body", _BODY[kind], _UNITS[kind]),
            *_numbers(reader, motor, "drive", _DRIVE[amplifier], _UNITS[kind]),
        )
        name = reader.text(mapping["name"], "name", 1)
        sources = {key.rpartition(".")[2]: text for key, text in reader.sources.items()}
        try:
            return cls(name, kind, amplifier, (low, high), scale, parameters, sources)
        except ParameterError as error:
            place = error.where if where is None else f"{where}: {error.where}"
            raise ParameterError(error.what, where=place, expected=error.expected) from None

    def to_mapping(self) -> dict[str, Any]:
        """The mapping of a mechanism file that loads to an equal value."""

        def entry(name: str, value: object, unit: str, **width: object) -> dict[str, Any]:
            source = {"source": self.sources[name]} if name in self.sources else {}
            return {"value": value, "unit": unit, **width, **source}

        def group(names: Sequence[str]) -> dict[str, Any]:
            own = [p for p in self.parameters if p.name in names]
            widths = [{"known": True} if p.known else {"deviation": p.deviation} for p in own]
            return {p.name: entry(p.name, p.value, p.unit, **width) for p, width in zip(own, widths)}

        return {
            "format": MECHANISM_FORMAT,
            "name": self.name,
            "kind": self.kind,
            "range": entry("range", list(self.limits), self.unit_of("rad")),
            "torque_scale": entry("torque_scale", self.torque_scale, self.unit_of("N.m")),
            "body": group(_BODY[self.kind]),
            "drive": {"amplifier": self.amplifier, **group(_DRIVE[self.amplifier])},
        }


def completed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers with those that a file may leave out; real or complex."""
    found = {**_OPTIONAL, **values}
    if "gain" in values:
        # one ampere or volt of command is one ampere here, and gives `gain`
        found |= {"resistance": 1.0, "inductance": 0.0, "back_emf": 0.0, "gear_ratio": 1.0}
        found["torque_constant"] = values["gain"]
    if found["back_emf"] is None:
        found["back_emf"] = found["torque_constant"]
    return found


def _numbers(
    reader: Reader, group: Any, key: str, names: Sequence[str], units: Mapping[str, tuple[str, ...]]
) -> Iterator[MechanismParameter]:
    """The parameters of one group of a file."""
    reader.keys(group, key, names, optional=_OPTIONAL)
    for name in names:
        if name not in group:
            continue
        at = f"{key}.{name}"
        entry = reader.entry(group[name], at, *units[name], further=_WIDTHS)
        value = reader.number(entry["value"], f"{at}.value", 0.0 if name in _MAY_BE_ZERO else 1e-12)
        widths = [word for word in _WIDTHS if word in entry]
        if len(widths) != 1 or entry.get("known", True) is not True:
            what = " and ".join(widths) or "no width of its prior"
            reader.fail(at, what, "one of deviation, relative_deviation or known: true")
        (word,), deviation = widths, 0.0
        if word != "known":
            deviation = reader.number(entry[word], f"{at}.{word}", 1e-12)
            deviation *= value if word == "relative_deviation" else 1.0
            if value == 0.0:
                reader.fail(at, "0 with a prior", "known: true, or a start above 0")
        yield MechanismParameter(name, str(entry["unit"]), value, deviation, known=word == "known")


def carrier(body: OneJoint, values: Mapping[str, float]) -> ArmParameters:
    """The arm whose third joint moves as the mechanism, with the others held at 0."""
    mass, slide = values["mass"], body.kind == "slide"
    # a slide's mass stands at a radius of 1 m, so that its inertia is the mass
    radius = 1.0 if slide else values["length"]
    positive = mass if mass > 0.0 else 1.0
    inertia = mass * radius**2 + (0.0 if slide else values["lever_inertia"])
    # the held links have inertia too, so that the whole arm's is positive definite
    ballast = inertia + values["motor_inertia"]
    held = (Link(ballast, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), Link(ballast, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    link = Link(positive, (0.0, 0.0, 0.0 if slide else radius * mass / positive), (0.0, inertia / positive, 0.0))
    motor = Motor(**{name: values[name] for name in _MOTOR}, inertia=values["motor_inertia"])
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

    Raises ParameterError: such an effect, or one on another joint.
    """

    body: OneJoint = field(kw_only=True)

    def __post_init__(self) -> None:
        for effect in self.effects:
            where, values = f"effect {effect.kind.name}", effect.on(self.arm).values
            reason = obstacle(self.body, effect.kind)
            if reason is not None:
                raise ParameterError(reason[0], where=where, expected=reason[1])
            if effect.joint not in (None, 1):
                expected = f"joint=1: '{self.body.name}' has one joint"
                raise ParameterError(f"joint {effect.joint}", where=where, expected=expected)
            if effect.kind.load is not None and (
                values["x"] != 0.0 or values["y"] != 0.0 or (self.body.kind == "slide" and values["z"] != 1.0)
            ):
                expected = "a mass alone, or z along the lever of a pendulum"
                raise ParameterError(f"beside the {self.body.kind}", where=where, expected=expected)
        super().__post_init__()

    @classmethod
    def of(  # type: ignore[override]
        cls, body: OneJoint, effects: Iterable[Effect] = (), values: Mapping[str, float] | None = None
    ) -> OneJointPlant:
        """The plant of a mechanism; `values` replace numbers of it by name.

        Raises ParameterError: an effect that cannot be on it.
        """
        body = body if not values else body.with_values(values)
        return cls(carrier(body, body.values), tuple(effects), body=body)

    @property
    def joints(self) -> int:
        return 1

    @property
    def position_unit(self) -> str:
        return self.body.unit_of("rad")

    @property
    def kernel_effects(self) -> tuple[Effect, ...]:
        return tuple(e if e.joint is None else Effect(e.kind, 3, e.values) for e in self.effects)

    @cached_property
    def viscous_friction(self) -> tuple[float, float, float]:
        own = self.body.values["viscous_friction"]
        return (0.0, 0.0, own + sum(e.values["coefficient"] for e in self.effects if e.kind is VISCOUS))

    def to_mapping(self) -> dict[str, Any]:
        return {
            "format": MODEL_FORMAT,
            "version": __version__,
            "mechanism": self.body.to_mapping(),
            "effects": [effect_mapping(e, self.body.unit_of) for e in self.effects],
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str | None = None) -> OneJointPlant:
        """The inverse of `to_mapping`; raises ModelError as `Plant.from_mapping`."""

        def make() -> OneJointPlant:
            Reader(None).keys(mapping, "", ("format", "version", "mechanism", "effects"), ("version", "effects"))
            body = OneJoint.from_mapping(mapping["mechanism"], "mechanism")
            return cls.of(body, effects_of_mapping(mapping, body.unit_of))

        return made_of_model(make, where)
