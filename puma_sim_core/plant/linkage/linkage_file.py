# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The mapping of a mechanism file as a `Linkage`, and back."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from puma_sim_core.arm.parameters import smallest_eigenvalue
from puma_sim_core.checks import Reader
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.carrier import carrier, layout_of
from puma_sim_core.plant.linkage.linkage import (
    BASE,
    ELBOW,
    HELD,
    PASSIVE,
    PLACES,
    POSITION,
    SHOULDER,
    SINGLE,
    Axis,
    Linkage,
)
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT, LinkSensor, MechanismParameter
from puma_sim_core.plant.quantities import (
    BASE_LINK,
    BODY,
    DRIVES,
    GRAVITY,
    GREATEST_FRICTION,
    GREATEST_SHARE,
    KNOWN,
    LINK,
    Quantity,
)

#: numbers of a link that count where the base moves alone
_UPRIGHT = ("beside", "inertia_along", "inertia_across")
#: the key of a second position sensor on the link's side
SENSOR = "link_sensor"
_WIDTHS = ("deviation", "relative_deviation", "known")
_SINGLE_KEYS = ("format", "name", "kind", "range", "torque_scale", "zero", "body", "drive", SENSOR)
#: no joint moves further [rad or m, or mm as m]; the checks of the masses walk over the range
_WIDEST = 1e4
#: angles of links are given within a turn, roughly [rad]
_TURNED = 10.0
_MOVING_KEYS = ("range", "torque_scale", "zero", "link", "drive", SENSOR)
_HELD_KEYS = (HELD, "zero", "link")


def read_linkage(mapping: Mapping[str, Any], reader: Reader | None = None) -> Linkage:
    """The linkage of the mapping of a mechanism file; reader : names the file in errors.

    Raises ParameterError: names the key, what is wrong and what was expected.
    """
    reader = reader or Reader(None)
    if not isinstance(mapping, Mapping):
        reader.fail("", repr(mapping), "the keys of a mechanism file")
    kind = reader.choice(mapping.get("kind"), "kind", (*SINGLE, "linkage"))
    axes, parameters = (_single if kind in SINGLE else _several)(reader, mapping, kind)
    name = reader.text(mapping["name"], "name", 1)
    try:
        linkage = Linkage(name, kind, axes, parameters, dict(reader.sources))
        layout_of(linkage)
        _check_inert(linkage)
    except ParameterError as error:
        place = error.where if reader.where is None else f"{reader.where}: {error.where}"
        raise ParameterError(error.what, where=place, expected=error.expected) from None
    return linkage


def link_quantities(upright: bool, elbow: bool, place: str) -> dict[str, Quantity]:
    """The numbers of a link in a file. upright : the base moves; elbow : there is one."""
    if place == BASE:
        return BASE_LINK
    left = {*(() if upright else _UPRIGHT), *(() if elbow and place == SHOULDER else ("length",))}
    return {name: quantity for name, quantity in LINK.items() if name not in left}


def body_quantities(kind: str) -> dict[str, Quantity]:
    """The numbers of the body of a pendulum or a slide."""
    return {"mass": BODY["mass"]} if kind == "slide" else {**BODY, "gravity": GRAVITY}


def _single(reader: Reader, mapping: Any, kind: str) -> tuple[tuple[Axis, ...], tuple[MechanismParameter, ...]]:
    # where a slide counts from makes no difference to any force
    keys = [key for key in _SINGLE_KEYS if key != "zero" or kind == "pendulum"]
    reader.keys(mapping, "", keys, optional=("format", "zero", SENSOR))
    limits, scale, amplifier = moving(reader, mapping, "", kind)
    zero, free = _zero(reader, mapping, "", "zero")
    parameters = (
        *free,
        *_numbers(reader, mapping["body"], "body", body_quantities(kind), kind),
        *drive_numbers(reader, mapping["drive"], "drive", amplifier, kind),
    )
    sensor = link_sensor(reader, mapping, "", kind)
    return (Axis(SHOULDER, amplifier, limits, scale, zero, bool(free), link_sensor=sensor),), parameters


def _several(reader: Reader, mapping: Any, kind: str) -> tuple[tuple[Axis, ...], tuple[MechanismParameter, ...]]:
    reader.keys(mapping, "", ("format", "name", "kind", "gravity", *PLACES), ("format", "gravity", *PLACES))
    places = [place for place in PLACES if place in mapping]
    if ELBOW in places and SHOULDER not in places:
        reader.fail(SHOULDER, "missing", "a shoulder before the elbow; one joint alone is a shoulder")
    upright = BASE in places and not _is_held(mapping[BASE])
    axes, parameters = list[Axis](), list[MechanismParameter]()
    if "gravity" in mapping:
        parameters += _numbers(reader, {"gravity": mapping["gravity"]}, "", {"gravity": GRAVITY}, kind)
    for place in places:
        quantities = link_quantities(upright, ELBOW in places, place)
        axis, own = _axis(reader, mapping[place], place, quantities)
        axes.append(axis)
        parameters += own
    _check_servos(reader, axes)
    free = {axis.place for axis in axes if axis.zero_free}
    if upright and ELBOW in places and SHOULDER in free:
        expected = "no deviation: on a base that moves, the shoulder's link is level at position 0"
        reader.fail(f"{SHOULDER}.zero.deviation", "beside a base and an elbow", expected)
    if not any(axis.moves for axis in axes):
        reader.fail("", "no joint moves", f"{', '.join(PLACES)}: one at least with a drive, or passive")
    return tuple(axes), tuple(parameters)


def _check_servos(reader: Reader, axes: Collection[Axis]) -> None:
    """Fail where some drives have goal positions as their input, and others have not."""
    others = [axis for axis in axes if axis.amplifier not in (POSITION, PASSIVE, HELD)]
    if others and any(axis.amplifier == POSITION for axis in axes):
        key = f"{others[0].place}.drive.amplifier"
        reader.fail(key, others[0].amplifier, "position, as on the other axes: goals or volts are the input of all")


def _axis(
    reader: Reader, entry: Any, place: str, quantities: Mapping[str, Quantity]
) -> tuple[Axis, list[MechanismParameter]]:
    """An axis of a linkage, and the numbers of its link and its drive."""
    held = _is_held(entry)
    keys = [key for key in (_HELD_KEYS if held else _MOVING_KEYS) if key != "zero" or place != BASE]
    reader.keys(entry, place, keys, optional=("zero", "link") if held and place == BASE else ("zero", SENSOR))
    zero, free = _zero(reader, entry, f"{place}.", f"{place}.zero")
    if free and held:
        reader.fail(f"{place}.zero.deviation", "of an axis that is held", "the deviation of an axis that moves")
    numbers = free[:]
    if "link" in entry:
        numbers += _numbers(reader, entry["link"], f"{place}.link", quantities, "linkage", f"{place}.")
    if held:
        angle = reader.quantity(entry[HELD], f"{place}.{HELD}", "rad", -_TURNED, _TURNED)
        return Axis(place, HELD, zero=zero, held=angle), numbers
    limits, scale, amplifier = moving(reader, entry, f"{place}.", "linkage")
    numbers += drive_numbers(reader, entry["drive"], f"{place}.drive", amplifier, "linkage", f"{place}.")
    sensor = link_sensor(reader, entry, f"{place}.", "linkage")
    return Axis(place, amplifier, limits, scale, zero, bool(free), link_sensor=sensor), numbers


def _zero(reader: Reader, entry: Any, key: str, name: str) -> tuple[float, list[MechanismParameter]]:
    """The angle at position 0 [rad] of an axis, and the parameter that it is where the file gives a deviation.

    key : the prefix of the axis' keys; name : of the parameter.
    """
    if "zero" not in entry:
        return 0.0, []
    at = f"{key}zero"
    own = reader.entry(entry["zero"], at, "rad", further=("deviation",))
    value = reader.number(own["value"], f"{at}.value", -_TURNED, _TURNED)
    if "deviation" not in own:
        return value, []
    deviation = reader.number(own["deviation"], f"{at}.deviation", 1e-12, _TURNED)
    return value, [MechanismParameter(name, "rad", value, deviation, False, False)]


def _is_held(entry: Any) -> bool:
    return isinstance(entry, Mapping) and HELD in entry


def moving(reader: Reader, entry: Mapping[str, Any], key: str, kind: str) -> tuple[tuple[float, float], float, str]:
    """Range, nominal friction and amplifier of an axis that moves; key : the prefix of its keys."""
    rad, effort = ("m", "N") if kind == "slide" else ("rad", "N.m")
    at = f"{key}range"
    low, high = reader.numbers(reader.entry(entry["range"], at, rad)["value"], f"{at}.value", 2)
    if not low < high:
        reader.fail(f"{at}.value", f"from {low:g} to {high:g}", "the lower end first")
    if max(abs(low), abs(high)) > _WIDEST:
        reader.fail(f"{at}.value", f"from {low:g} to {high:g}", f"ends within {_WIDEST:g} {rad} of zero")
    scale = reader.quantity(entry["torque_scale"], f"{key}torque_scale", effort, 1e-9, GREATEST_FRICTION)
    drive = entry["drive"]
    found = drive.get("amplifier") if isinstance(drive, Mapping) else drive
    return (low, high), scale, reader.choice(found, f"{key}drive.amplifier", DRIVES)


def link_sensor(reader: Reader, entry: Mapping[str, Any], key: str, kind: str) -> LinkSensor | None:
    """The sensor on the link's side of a joint, None without one; key : the prefix of its keys."""
    if SENSOR not in entry:
        return None
    own = reader.keys(entry[SENSOR], f"{key}{SENSOR}", LinkSensor._fields)
    unit = "m" if kind == "slide" else "rad"
    return LinkSensor(reader.quantity(own["resolution"], f"{key}{SENSOR}.resolution", unit, 1e-12, 1.0))


def drive_numbers(
    reader: Reader, drive: Mapping[str, Any], key: str, amplifier: str, kind: str, prefix: str = ""
) -> Iterator[MechanismParameter]:
    """The numbers of a drive; prefix : of their names."""
    motor = {name: value for name, value in drive.items() if name != "amplifier"}
    return _numbers(reader, motor, key, DRIVES[amplifier], kind, prefix)


def _numbers(
    reader: Reader, group: Any, key: str, quantities: Mapping[str, Quantity], kind: str, prefix: str = ""
) -> Iterator[MechanismParameter]:
    """The parameters of one group of a file; prefix : of their names."""
    optional: Collection[str] = [name for name, quantity in quantities.items() if quantity.default is not None]
    reader.keys(group, key, quantities, optional)
    for name, quantity in quantities.items():
        if name not in group:
            continue
        at = f"{key}.{name}" if key else name
        entry = reader.entry(group[name], at, *quantity.of(kind), further=_WIDTHS)
        value = reader.number(entry["value"], f"{at}.value", quantity.least, quantity.greatest(entry["unit"]))
        widths = [word for word in _WIDTHS if word in entry]
        if name in KNOWN and widths != ["known"]:
            reader.fail(at, " and ".join(widths) or "no width of its prior", "known: true")
        if len(widths) != 1 or entry.get("known", True) is not True:
            what = " and ".join(widths) or "no width of its prior"
            reader.fail(at, what, "one of deviation, relative_deviation or known: true")
        (word,), deviation, signed = widths, 0.0, quantity.sign == "any"
        if word != "known":
            most = GREATEST_SHARE if word == "relative_deviation" else quantity.greatest(entry["unit"])
            deviation = reader.number(entry[word], f"{at}.{word}", 1e-12, most)
            deviation *= abs(value) if word == "relative_deviation" else 1.0
            if deviation == 0.0 or (value == 0.0 and not signed):
                reader.fail(at, "0 with a prior", f"known: true, {'a deviation' if signed else 'or a start above 0'}")
        positive = not signed and value > 0.0
        yield MechanismParameter(prefix + name, str(entry["unit"]), value, deviation, word == "known", positive)


def _check_inert(linkage: Linkage) -> None:
    """Raise ParameterError where some motion would take no force."""
    if not smallest_eigenvalue(carrier(linkage, linkage.values))[0] > 0.0:
        expected = "mass, inertia or motor_inertia above 0 that each joint moves"
        raise ParameterError("nothing that is inert", where=f"mechanism '{linkage.name}'", expected=expected)


def check_bodies(linkage: Linkage, reader: Reader) -> None:
    """Raise ParameterError where the inertia of a link is none of any body; a fit may leave that a little."""
    for axis in linkage.axes if linkage.turns(BASE) else ():
        v = linkage.numbers(linkage.values, axis.place)
        moments = [v["inertia"], v["inertia_along"], v["inertia_across"]]
        if axis.place != BASE and 2.0 * max(moments) > sum(moments) * (1.0 + 1e-9):
            found = ", ".join(f"{m:g}" for m in moments)
            what, key = f"inertia, inertia_along, inertia_across {found}", f"{axis.place}.link"
            reader.fail(key, what, "none greater than the sum of the others, as of any body")


def linkage_mapping(linkage: Linkage) -> dict[str, Any]:
    """The mapping of a mechanism file that loads to an equal linkage."""

    def entry(key: str, value: object, unit: str, **width: object) -> dict[str, Any]:
        source = {"source": linkage.sources[key]} if key in linkage.sources else {}
        return {"value": value, "unit": unit, **width, **source}

    def group(key: str, names: Collection[str], prefix: str = "") -> dict[str, Any]:
        own = [p for p in linkage.parameters if p.name in {prefix + name for name in names}]
        widths = [{"known": True} if p.known else {"deviation": p.deviation} for p in own]
        found = [(p, p.name.removeprefix(prefix), width) for p, width in zip(own, widths)]
        return {name: entry(f"{key}.{name}", p.value, p.unit, **width) for p, name, width in found}

    def limits(axis: Axis, key: str) -> dict[str, Any]:
        rad, effort = linkage.unit_of("rad"), linkage.unit_of("N.m")
        sensor = axis.link_sensor
        own = {} if sensor is None else {"resolution": entry(f"{key}{SENSOR}.resolution", sensor.resolution, rad)}
        return {
            "range": entry(f"{key}range", list(axis.limits), rad),
            "torque_scale": entry(f"{key}torque_scale", axis.torque_scale, effort),
            **({SENSOR: own} if own else {}),
        }

    def zero(axis: Axis, key: str) -> dict[str, Any]:
        name = linkage.zero_of(axis.place)
        own = next(({"deviation": p.deviation} for p in linkage.parameters if p.name == name), {})
        return {"zero": entry(f"{key}zero", axis.zero, "rad", **own)} if axis.zero or own else {}

    head: dict[str, Any] = {"format": MECHANISM_FORMAT, "name": linkage.name, "kind": linkage.kind}
    if linkage.kind in SINGLE:
        (axis,) = linkage.axes
        drive = {"amplifier": axis.amplifier, **group("drive", DRIVES[axis.amplifier])}
        own = {**limits(axis, ""), **zero(axis, "")}
        return {**head, **own, "body": group("body", body_quantities(linkage.kind)), "drive": drive}
    head |= {
        p.name: entry(p.name, p.value, p.unit, **({"known": True} if p.known else {"deviation": p.deviation}))
        for p in linkage.parameters
        if p.name == "gravity"
    }
    for axis in linkage.axes:
        place, own = axis.place, zero(axis, f"{axis.place}.")
        link = {"link": group(f"{place}.link", {**LINK, **BASE_LINK}, f"{place}.")}
        if axis.moves:
            drive = {"amplifier": axis.amplifier, **group(f"{place}.drive", DRIVES[axis.amplifier], f"{place}.")}
            head[place] = {**limits(axis, f"{place}."), **own, **link, "drive": drive}
        else:
            head[place] = {HELD: entry(f"{place}.{HELD}", axis.held, "rad"), **own, **(link if link["link"] else {})}
    return head
