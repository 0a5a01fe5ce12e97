# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Describe a machine for `explain`: write a mechanism file to fill in, or show what one says.

  puma-sim mechanism new lever.yaml --kind pendulum --drive voltage
  puma-sim mechanism new furuta.yaml --kind linkage --base voltage --shoulder none
  puma-sim mechanism new double.yaml --kind linkage --shoulder torque --elbow torque
  puma-sim mechanism show furuta.yaml       checks the file, and says how it is read

A linkage is an arm or a part of it: base (vertical axis), shoulder and elbow (parallel axes). Each is driven on
voltage, current or torque, on goal positions with a servo in the drive, has no drive (none), is held, or is not there.
Of a transmission nothing is known but the readings of both its sides, and the torque of its motor.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from puma_sim_core.cli.arguments import Command
from puma_sim_core.cli.output import add_force_argument, check_output, output_file
from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    from puma_sim_core.plant.mechanism import Mechanism

_PLACES = ("base", "shoulder", "elbow")
_AMPLIFIERS = ("voltage", "current", "torque", "position", "none")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    new = actions.add_parser("new", help="write a file to fill in")
    new.add_argument("file", metavar="FILE", help="the file to write; - for standard output")
    add_force_argument(new)
    kinds = ("arm", "linkage", "pendulum", "slide", "transmission")
    new.add_argument("--kind", choices=kinds, required=True, help="what moves")
    new.add_argument("--drive", choices=_AMPLIFIERS, help="of a pendulum, a slide, or a transmission")
    for place in _PLACES:
        new.add_argument(f"--{place}", choices=(*_AMPLIFIERS, "held"), help=f"the {place} of a linkage")
    show = actions.add_parser("show", help="check a file, and say how it is read")
    show.add_argument("name", metavar="NAME", help="a mechanism of `puma-sim list mechanisms`, or a file")


def run(options: argparse.Namespace) -> int:
    """Write or show; raises ParameterError."""
    return _new(options) if options.action == "new" else _show(options.name)


def _new(options: argparse.Namespace) -> int:
    from pathlib import Path

    from puma_sim_core.plant.template import template

    given = {place: getattr(options, place) for place in _PLACES if getattr(options, place) is not None}
    if options.kind == "linkage" and options.drive is not None:
        raise ParameterError("--drive of a linkage", expected="--base, --shoulder and --elbow with a drive each")
    if options.drive is not None:
        given = {**given, "shoulder": options.drive}
    elif options.kind in ("pendulum", "slide", "transmission") and "shoulder" in given:
        raise ParameterError(f"--shoulder of a {options.kind}", expected="--drive")
    name = "mine" if options.file == "-" else Path(options.file).stem
    text = template(name, options.kind, given)
    check_output(options.file, force=options.force)
    with output_file(options.file, ParameterError) as file:
        file.write(text)
    return 0


def _show(name: str) -> int:
    from puma_sim_core.plant.mechanism_file import load_mechanism

    print("\n".join(_lines(load_mechanism(name))))
    return 0


def _lines(m: Mechanism) -> Iterator[str]:
    yield f"{m.name}: {m.joints} joint{'s' * (m.joints > 1)} that move{'s' * (m.joints == 1)}"
    drive = m.drive(m.start)
    for j, (low, high) in enumerate(m.ranges):
        rad, effort = m.position_unit, m.effort_unit
        motor = "driven" if m.driven[j] else "no drive"
        words = f"{low:g} to {high:g} {rad}, friction about {m.torque_scale[j]:g} {effort}, {motor}"
        sensor = m.link_sensors[j]
        if sensor is not None:
            words += f", a sensor on the link's side with steps of {sensor.resolution:g} {rad}"
        if m.driven[j]:
            words += f", {drive.volts_per_torque[j]:.4g} of the input for 1 {effort}"
        yield f"  joint {j + 1}: {words}"
    width = max((len(p.name) for p in m.parameters), default=0)
    for p in m.parameters:
        prior = "known" if p.known else f"+- {p.deviation:.3g}"
        yield f"  {p.name:{width}}  {p.value:.6g} {prior} {p.unit}"


COMMAND = Command("mechanism", "write a mechanism file to fill in, or check one", __doc__, add_arguments, run)
