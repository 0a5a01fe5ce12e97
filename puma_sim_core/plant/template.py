# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Mechanism files to fill in, made of the same tables that the files are read by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.linkage.linkage import BASE, ELBOW, HELD, PLACES, SHOULDER
from puma_sim_core.plant.linkage.linkage_file import SENSOR, body_quantities, link_quantities
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT
from puma_sim_core.plant.quantities import AMPLIFIERS, DRIVES, GRAVITY, KNOWN, Quantity
from puma_sim_core.plant.transmission import AMPLIFIERS_OF_TRANSMISSIONS
from puma_sim_core.resources import config_path

_HEAD = """\
# A mechanism for `puma-sim explain --plant FILE`. Fill in each `value`, and say in `source` where it comes from.
# What is known of a number is one of
#   known: true                taken as it is
#   deviation: D               standard deviation of the prior, in the unit of the number
#   relative_deviation: S      the same as a share of the number
# A prior that is too narrow forces errors of the numbers into effects; one that is too wide weakens the evidence for
# effects. Lines that begin with "# " and a name may be left out: then the value in them is taken.
# The reference is docs/mechanisms.md; `puma-sim mechanism show FILE` checks the file.
"""
_RANGE = "lowest and highest position of the joint, such as [-1.5, 1.5]: beyond them a log is at fault"
_SCALE = "size of the joint's friction, such as a tenth of its greatest torque: unit of all priors of effects"
_SENSOR = "a second position sensor, on the link's side of the gear, and the least change that it shows"
_ZERO = {
    SHOULDER: "angle of the link at position 0, from hanging down: 1.5707963 is level, positive up; 3.1415927 upright",
    ELBOW: "angle of the link at position 0, from stretched",
}
_FITTED = "; with a deviation it is fitted, as where it is set by hand"


def template(name: str, kind: str, drives: Mapping[str, str]) -> str:
    """A mechanism file to fill in.

    drives : of a linkage, the amplifier ("held" where it is held) of each axis that it has; of a pendulum or a slide,
    that of its "shoulder", and so of the first joint of a transmission; of an arm none.

    Raises ParameterError: axes that such a machine does not have.
    """
    expected = {
        "arm": "no drive: an arm has three motors on voltage",
        "linkage": "a shoulder, a base, or both",
        "transmission": "a drive on torque, on current, or none",
    }
    single = expected.get(kind, "one drive, as with --drive voltage")
    fits = {"arm": not drives, "linkage": bool(drives) and (ELBOW not in drives or SHOULDER in drives)}
    fits["transmission"] = list(drives) == [SHOULDER] and drives[SHOULDER] in AMPLIFIERS_OF_TRANSMISSIONS
    if not fits.get(kind, set(drives) == {SHOULDER}):
        given = ", ".join(f"{place} {amplifier}" for place, amplifier in drives.items()) or "no drive"
        raise ParameterError(given, where=f"a mechanism of kind {kind}", expected=single)
    if kind == "arm":
        text = config_path("mechanisms", "puma560.yaml").read_text(encoding="utf-8")
        return text.replace("name: puma560", f"name: {name}")
    head = [_HEAD.rstrip(), f"format: {MECHANISM_FORMAT}", f"name: {name}", f"kind: {kind}"]
    if kind == "transmission":
        body = _transmission(drives[SHOULDER])
    else:
        body = _single(kind, drives[SHOULDER]) if kind != "linkage" else _several(drives)
    return "\n".join([*head, *body]) + "\n"


def _single(kind: str, amplifier: str) -> Iterator[str]:
    yield from _limits(kind, "")
    if kind == "pendulum":
        yield from _zero(SHOULDER, "", _FITTED)
    yield "body:"
    yield from _entries(body_quantities(kind), kind, "  ")
    yield from _drive(kind, amplifier, "")


def _transmission(amplifier: str) -> Iterator[str]:
    yield "joint1:  # and so on: joint2, joint3"
    yield from _limits("transmission", "  ")
    yield "  drive:"
    yield f"    amplifier: {amplifier}  # {AMPLIFIERS[amplifier]}"
    yield from _entries(DRIVES[amplifier], "transmission", "    ", known=True)


def _several(drives: Mapping[str, str]) -> Iterator[str]:
    upright, number = drives.get(BASE, HELD) != HELD, 0
    yield from _entries({"gravity": GRAVITY}, "linkage", "")
    for place in (place for place in PLACES if place in drives):
        held = drives[place] == HELD
        number += not held
        yield f"{place}:" + ("  # does not move" if held else f"  # joint {number} of a log")
        if held:
            yield "  # position at which it is held"
            yield '  held: {value: , unit: rad, source: ""}'
        else:
            yield from _limits("linkage", "  ")
        if place in _ZERO:
            yield from _zero(place, "  ", "" if held else _FITTED)
        if not held or place != BASE:
            yield "  link:"
            yield from _entries(link_quantities(upright, ELBOW in drives, place), "linkage", "    ")
        if not held:
            yield from _drive("linkage", drives[place], "  ")


def _zero(place: str, indent: str, further: str) -> Iterator[str]:
    yield f"{indent}# {_ZERO[place]}{further}"
    yield f"{indent}# zero: {{value: 0.0, unit: rad}}"


def _limits(kind: str, indent: str) -> Iterator[str]:
    rad, effort = ("m", "N") if kind == "slide" else ("rad", "N.m")
    optional = "" if kind == "transmission" else "# "
    yield f"{indent}# {_SENSOR}"
    yield f"{indent}{optional}{SENSOR}:"
    yield f'{indent}{optional}  resolution: {{value: , unit: {rad}, source: ""}}'
    yield f"{indent}# {_RANGE}"
    yield f'{indent}range: {{value: , unit: {rad}, source: ""}}'
    yield f"{indent}# {_SCALE}"
    yield f'{indent}torque_scale: {{value: , unit: {effort}, source: ""}}'


def _drive(kind: str, amplifier: str, indent: str) -> Iterator[str]:
    yield f"{indent}drive:"
    yield f"{indent}  amplifier: {amplifier}  # {AMPLIFIERS[amplifier]}"
    yield from _entries(DRIVES[amplifier], kind, f"{indent}  ")


def _entries(quantities: Mapping[str, Quantity], kind: str, indent: str, known: bool = False) -> Iterator[str]:
    """Lines of some numbers; known : none of them has a prior."""
    for name, quantity in quantities.items():
        units, default = quantity.of(kind), quantity.default
        unit = f'"{units[0]}"' if units[0] == "1" else units[0]
        choice = f" ({' or '.join(units)})" if len(units) > 1 else ""
        taken = "" if default is None else f"; without it {default}"
        yield f"{indent}# {quantity.meaning}{choice}{taken}"
        if default is None and (known or name in KNOWN):
            yield f'{indent}{name}: {{value: , unit: {unit}, known: true, source: ""}}'
        elif default is None:
            yield f'{indent}{name}: {{value: , unit: {unit}, relative_deviation: 0.1, source: ""}}'
        else:
            value = default if isinstance(default, float) else ""
            yield f'{indent}# {name}: {{value: {value}, unit: {unit}, known: true, source: ""}}'
