# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How the effects of the library are looked for in a measured log, by name of the kind.

`SCREENINGS` holds one `Screening` a kind; the kinds refer to it. Viscous friction is missing from
it: it is a parameter of every mechanism, which competes with all effects.
"""

from __future__ import annotations

from puma_sim_core.effects.columns import amplifier, friction, load, motor, outside, sensing, stops, transmission
from puma_sim_core.effects.screening import Screening

SCREENINGS: dict[str, Screening] = {
    name: screening
    for family in (friction, amplifier, motor, outside, load, stops, sensing, transmission)
    for name, screening in family.SCREENINGS.items()
}

#: effects that act on the whole arm: their candidates are asked for with joint None
WHOLE_ARM = ("payload", "base_tilt", "supply_droop", "input_delay")

#: (one, other, why): what voltage and position alone can never tell apart
EXACT_TIES: tuple[tuple[str, str, str], ...] = (
    (
        "the constant of back-EMF",
        "viscous_friction",
        "both take a voltage in proportion to the speed; only heat and cold, or a current, differ",
    ),
    (
        "the ratio of resistance to torque constant",
        "the scale of all torques of the joint",
        "voltage is their product; a known weight or a measured current separates them",
    ),
    ("input_delay", "a delay of the sensor", "the log shows the sum of the two delays"),
    (
        "the gain of the amplifier",
        "resistance, back-EMF and inductance together",
        "all voltages scale by it; a voltmeter at the motor separates them",
    ),
    ("voltage_offset", "a constant torque", "both are a constant in the voltage"),
    (
        "asymmetric_coulomb_friction",
        "coulomb_friction with voltage_offset",
        "while the joint moves they are the same; at rest friction holds and an offset pushes",
    ),
    ("joint_spring", "a spring slack at another angle with voltage_offset", "both are a line in the position"),
    (
        "payload",
        "a direction of the inertial parameters of the last link",
        "the arm without the load is known only within the widths of its parameters",
    ),
)
