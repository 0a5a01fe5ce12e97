# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm that a linkage is a part of: which joints of the kernel move, its links, and the zeros of its angles.

The links are those of `arm.Link`: the shoulder's link with its frame at the elbow and x along it, the last one with z
along it. A linkage without an elbow has its shoulder as the kernel's third joint, the second held and without length.
Where the angles of a linkage are zero, the twenty constants of the arm are turned (`turned`); the kernel knows no more
of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, pi, sin
from typing import Any, NamedTuple

from puma_sim_core.arm.arm import ArmParameters, Link, Motor
from puma_sim_core.arm.rigid_body import Lumps
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.linkage.linkage import BASE, ELBOW, SHOULDER, SINGLE, Axis, Linkage

_MOTOR = ("resistance", "inductance", "back_emf", "torque_constant", "gear_ratio")
_CENTRE = (0.0, 0.0, 0.0)
#: any range: what depends on an angle is looked at over a whole turn
_TURN = (-pi, pi)
#: angles closer to whole multiples of a right angle than this are these [rad]
_RIGHT = 1e-9


class Layout(NamedTuple):
    """Where a linkage stands in the kernel: joints that move, positions [rad] at which the others are held, and the
    angles [rad] of joints 2 and 3 of the arm at position 0 of those that move."""

    axes: tuple[int, ...]
    rest: tuple[float, float, float]
    turn: tuple[float, float]


def layout_of(linkage: Linkage) -> Layout:
    """The layout of a linkage.

    Raises ParameterError: base and shoulder move, there is an elbow, and the shoulder's link is not level at 0.
    """
    places = _places(linkage)
    rest, turn = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    for axis, place in places.items():
        if axis.place == BASE:
            continue
        angle = _angle(axis, place, axis.zero)
        if axis.moves:
            turn[place] = angle
        else:
            rest[place] = axis.held + angle
    if linkage.turns(BASE) and linkage.turns(SHOULDER) and linkage.axis(ELBOW) and abs(sin(turn[1])) > _RIGHT:
        what = f"the shoulder's link {turn[1] - 0.5 * pi:g} rad from hanging down at position 0, on a base that moves"
        expected = "shoulder.zero -1.5707963267948966 (level, positive down) or 1.5707963267948966 (level, positive up)"
        raise ParameterError(what, where=f"mechanism '{linkage.name}'", expected=expected)
    moving = tuple(place for axis, place in places.items() if axis.moves)
    return Layout(moving, (rest[0], rest[1], rest[2]), (turn[1], turn[2]))


def turn_of(linkage: Linkage, values: Mapping[str, Any]) -> tuple[Any, Any]:
    """The turn of a layout with zeros of `values`, real or complex."""
    turn: list[Any] = [0.0, 0.0, 0.0]
    for axis, place in _places(linkage).items():
        if axis.moves and axis.place != BASE:
            turn[place] = _angle(axis, place, values.get(linkage.zero_of(axis.place), axis.zero))
    return turn[1], turn[2]


def _angle(axis: Axis, place: int, zero: Any) -> Any:
    """The kernel's angle of an axis at position 0: it counts the second joint from level, downward, and the third from
    upright on a level second."""
    return zero + (pi if place == 2 and axis.place == SHOULDER else 0.5 * pi)


def carrier(linkage: Linkage, values: Mapping[str, Any]) -> ArmParameters:
    """The arm whose joints move as the linkage; values : of its numbers, real or complex."""
    places = {place: axis for axis, place in _places(linkage).items()}
    upright = linkage.turns(BASE)
    numbers = {place: linkage.numbers(values, axis.place) for place, axis in places.items()}
    inert = [v["mass"] * v["centre"] ** 2 + v["inertia"] + v["motor_inertia"] for v in numbers.values()]
    # joints that are not there have inertia too, so that the whole arm's is positive definite
    ballast = inert[0] if len(inert) == 1 else sum(inert)
    first, second = Link(ballast, _CENTRE, (0.0, 1.0, 0.0)), Link(ballast, _CENTRE, (0.0, 0.0, 1.0))
    third = Link(ballast, _CENTRE, (0.0, 1.0, 0.0))
    if upright:
        first = Link(1.0, _CENTRE, (0.0, numbers[0]["inertia"], 0.0))
    if 1 in places:
        second = _second(numbers[1], upright)
    if 2 in places:
        third = _third(numbers[2], upright)
    any_motor = next(place for place, axis in places.items() if axis.moves)
    motors: list[Any] = []
    for place in range(3):
        v = numbers[place] if place in places and places[place].moves else numbers[any_motor]
        motors.append(Motor(**{name: v[name] for name in _MOTOR}, inertia=v["motor_inertia"]))
    return ArmParameters(
        linkage.name,
        f"mechanism '{linkage.name}'",
        (first, second, third),
        tuple(motors),  # type: ignore[arg-type]
        a2=numbers[1]["length"] if 1 in places else 0.0,
        a3=0.0,
        d3=0.0,
        d4=numbers[2]["centre"] if 2 in places else 0.0,
        gravity=linkage.gravity(values),
        joint_ranges=(_TURN, _TURN, linkage.axes[0].limits if linkage.kind in SINGLE else _TURN),
    )


def turned(k: Lumps, turn: tuple[Any, Any]) -> Lumps:
    """The constants by angles that are 0 where those of the second and third joint are `turn` [rad], real or with the
    small imaginary part of a complex step.

    D11 is so for any angles only where the base is held, the second joint is, or its angle is a multiple of a half
    turn.
    """
    second, third = turn
    c2, s2 = _cosine(second), _sine(second)
    c3, s3 = _cosine(third), _sine(third)
    c, s = _cosine(second + third), _sine(second + third)
    double_c2, double_s2 = c2 * c2 - s2 * s2, 2.0 * s2 * c2
    double_c, double_s = c * c - s * s, 2.0 * s * c
    return k._replace(
        A0=k.A0 + s2 * s2 * k.A1 - s2 * c2 * k.A2 + s * s * k.A3 - s * c * k.A4,
        A1=double_c2 * k.A1 + double_s2 * k.A2,
        A2=double_c2 * k.A2 - double_s2 * k.A1,
        A3=double_c * k.A3 + double_s * k.A4,
        A4=double_c * k.A4 - double_s * k.A3,
        A5=c2 * (c * k.A5 + s * k.A6),
        A6=c2 * (c * k.A6 - s * k.A5),
        B1=c * k.B1 - s * k.B2,
        B2=c * k.B2 + s * k.B1,
        B3=c2 * k.B3 - s2 * k.B4,
        B4=c2 * k.B4 + s2 * k.B3,
        E1=c3 * k.E1 + s3 * k.E2,
        E2=c3 * k.E2 - s3 * k.E1,
        g1=c * k.g1 + s * k.g2,
        g2=c * k.g2 - s * k.g1,
        g3=c2 * k.g3 + s2 * k.g4,
        g4=c2 * k.g4 - s2 * k.g3,
    )


def _places(linkage: Linkage) -> dict[Axis, int]:
    """The joint of the kernel, 0-based, of each axis; a base that is held is as none."""
    last = {SHOULDER: 1 if linkage.axis(ELBOW) else 2, ELBOW: 2, BASE: 0}
    return {axis: last[axis.place] for axis in linkage.axes if axis.moves or axis.place != BASE}


def _second(v: Mapping[str, Any], upright: bool) -> Link:
    """The shoulder's link, with x along it from the elbow on, y across and z beside."""
    mass, along, y, z = _placed(v, upright)
    x = along - v["length"]
    zz = x * x + y * y + v["inertia"] / mass
    xx = y * y + z * z + v["inertia_along"] / mass if upright else 0.0
    yy = x * x + z * z + v["inertia_across"] / mass if upright else zz
    return Link(mass, (x, y, z), (xx, yy, zz), (x * y, y * z, x * z) if upright else _CENTRE)


def _third(v: Mapping[str, Any], upright: bool) -> Link:
    """The last link, with z along it, x across and y beside."""
    mass, z, x, y = _placed(v, upright)
    yy = (v["mass"] * (z * z + x * x) + v["inertia"]) / mass
    xx = y * y + z * z + v["inertia_across"] / mass if upright else 0.0
    zz = x * x + y * y + v["inertia_along"] / mass if upright else 0.0
    return Link(mass, (x, y, z), (xx, yy, zz), (x * y, y * z, x * z) if upright else _CENTRE)


def _placed(v: Mapping[str, Any], upright: bool) -> tuple[Any, Any, Any, Any]:
    """Mass and its place along, across and beside the link; a link with inertia alone is 1 kg on its joint's axis.

    upright : the base moves, so that what is beside the plane of motion counts.
    """
    if not v["mass"].real > 0.0:
        return 1.0, 0.0, 0.0, 0.0
    return v["mass"], v["centre"], v["across"], v["beside"] if upright else 0.0


def _cosine(angle: Any) -> Any:
    if isinstance(angle, complex):
        return complex(_cosine(angle.real), -_sine(angle.real) * angle.imag)
    quarter = angle / (0.5 * pi)
    return cos(angle) if abs(quarter - round(quarter)) > _RIGHT else (1.0, 0.0, -1.0, 0.0)[round(quarter) % 4]


def _sine(angle: Any) -> Any:
    return _cosine(angle - 0.5 * pi)
