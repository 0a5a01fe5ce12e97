# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Linkages: an arm whose first axis is vertical and whose second and third are parallel, or a part of it.

Its axes are the `base` (vertical), the `shoulder` and the `elbow` (parallel, at a right angle to the base's). Each is
driven, passive (without a drive), held at an angle, or absent. A pendulum is a shoulder alone, and so is a slide, whose
mass stands at a radius of 1 m without gravity: a radian there is a metre. A planar double pendulum is shoulder and
elbow, a rotary pendulum base and shoulder. Logs number the joints that move in this order.

The shoulder's angle counts from hanging down and the elbow's from stretched; `zero` is that angle at position 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from typing import Any

from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.mechanism import LinkSensor, MechanismParameter, linear_unit

BASE, SHOULDER, ELBOW = PLACES = ("base", "shoulder", "elbow")
#: kinds of files with one joint, whose numbers have no name of an axis before them
SINGLE = ("pendulum", "slide")
HELD, PASSIVE, VOLTS, POSITION = "held", "none", "voltage", "position"
#: L/R that a step of the kernel resolves [s]; a smaller one is negligible beside any motion here
_LEAST_LAG = 5e-4
#: numbers of a pendulum as those of a link
_AS_LINK = {"length": "centre", "lever_inertia": "inertia"}
#: what a file may leave out; without back_emf it is the torque constant, as in any DC motor
_DEFAULTS: dict[str, Any] = {
    **dict.fromkeys(("mass", "length", "centre", "across", "beside", "inertia", "inertia_along"), 0.0),
    **dict.fromkeys(("inductance", "motor_inertia", "viscous_friction", "servo_damping"), 0.0),
    "gear_ratio": 1.0,
    "servo_limit": inf,
}
#: one unit of command is one ampere here, and gives `gain`
_COMMANDED: dict[str, float] = {"resistance": 1.0, "inductance": 0.0, "back_emf": 0.0, "gear_ratio": 1.0}


@dataclass(frozen=True)
class Axis:
    """An axis that a linkage has.

    place : of `PLACES`; amplifier : of `quantities.AMPLIFIERS`, or "held"; limits : range [rad or m]; torque_scale :
    nominal friction [N.m or N]; zero [rad]: angle at position 0; zero_free : whether that is a parameter (`zero_of`);
    held : position [rad] of an axis that is held; link_sensor : that on the link's side, None without one.
    """

    place: str
    amplifier: str
    limits: tuple[float, float] = (0.0, 0.0)
    torque_scale: float = 0.0
    zero: float = 0.0
    zero_free: bool = False
    held: float = 0.0
    link_sensor: LinkSensor | None = None

    @property
    def moves(self) -> bool:
        """Whether it is driven or passive."""
        return self.amplifier != HELD

    @property
    def on_voltage(self) -> bool:
        """Whether a DC motor on voltage drives it, with or without a servo in the drive."""
        return self.amplifier in (VOLTS, POSITION)


@dataclass(frozen=True)
class Linkage:
    """The numbers of a linkage, with their priors.

    kind : "pendulum", "slide" or "linkage"; axes : those that it has, from the base on; parameters : in the order of a
    file, without those that it leaves out, of a linkage as AXIS.NAME.

    Raises ParameterError: numbers that no such machine can have.
    """

    name: str
    kind: str
    axes: tuple[Axis, ...]
    parameters: tuple[MechanismParameter, ...]
    sources: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        where = f"mechanism '{self.name}'"
        for axis in self.moving:
            v = self.numbers(self.values, axis.place)
            if axis.on_voltage and 0.0 < v["inductance"] < _LEAST_LAG * v["resistance"]:
                lag = f"a time constant of {1e3 * v['inductance'] / v['resistance']:.3g} ms"
                what = f"inductance {v['inductance']:g} H with {v['resistance']:g} ohm: {lag}"
                expected = f"0 where it is negligible, or L/R of {1e3 * _LEAST_LAG:g} ms or more"
                raise ParameterError(what, where=where, expected=expected)

    @cached_property
    def moving(self) -> tuple[Axis, ...]:
        """The axes that move, driven or passive: joints 1 to J of a log."""
        return tuple(axis for axis in self.axes if axis.moves)

    def axis(self, place: str) -> Axis | None:
        """The axis at a place, None where there is none."""
        return next((axis for axis in self.axes if axis.place == place), None)

    def turns(self, place: str) -> bool:
        """Whether the axis at a place is there and moves."""
        axis = self.axis(place)
        return axis is not None and axis.moves

    @cached_property
    def values(self) -> dict[str, float]:
        """name -> value of the numbers of the file."""
        return {p.name: p.value for p in self.parameters}

    def zero_of(self, place: str) -> str:
        """Name of the parameter that is the zero of an axis."""
        return "zero" if self.kind in SINGLE else f"{place}.zero"

    def gravity(self, values: Mapping[str, Any]) -> Any:
        """Pull of gravity [m/s^2]."""
        return 0.0 if self.kind == "slide" else values.get("gravity", 9.81)

    def numbers(self, values: Mapping[str, Any], place: str) -> dict[str, Any]:
        """Numbers of an axis and its link, real or complex, with those that a file leaves out."""
        if self.kind in SINGLE:
            own = {_AS_LINK.get(name, name): value for name, value in values.items() if name != "gravity"}
        else:
            own = {name.partition(".")[2]: value for name, value in values.items() if name.startswith(f"{place}.")}
        found = {**_DEFAULTS, **own}
        axis = self.axis(place)
        if self.kind == "slide":
            found["centre"] = 1.0
        if axis is not None and not axis.on_voltage:
            found |= {**_COMMANDED, "torque_constant": found.get("gain", 1.0)}
        found.setdefault("back_emf", found.get("torque_constant"))
        found.setdefault("inertia_across", found["inertia"])
        return found

    def unit_of(self, unit: str) -> str:
        """The unit here of an effect's parameter that has `unit` on a turning joint."""
        return linear_unit(unit) if self.kind == "slide" else unit

    def with_values(self, values: Mapping[str, float]) -> Linkage:
        """The linkage with numbers replaced; priors keep their width in proportion."""

        def moved(p: MechanismParameter) -> MechanismParameter:
            value = float(values.get(p.name, p.value))
            proportion = abs(value / p.value) if p.value else 1.0
            return replace(p, value=value, deviation=p.deviation * proportion)

        axes = (replace(axis, zero=values.get(self.zero_of(axis.place), axis.zero)) for axis in self.axes)
        return replace(self, axes=tuple(axes), parameters=tuple(map(moved, self.parameters)))
