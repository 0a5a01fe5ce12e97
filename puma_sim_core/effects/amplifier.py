# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the power amplifier does to the voltage that the controller asks for."""

from __future__ import annotations

from math import inf

from puma_sim_core.effects.base import ALWAYS, CURRENT, CURRENT_LIMIT, DELAYED, DROOP, VOLTAGE, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS
from puma_sim_core.jit import inlined

SATURATION = Kind(
    name="voltage_saturation",
    acts=VOLTAGE,
    stage=ALWAYS,
    screening=SCREENINGS["voltage_saturation"],
    equation="V = min(max(V, -Vs), Vs)",
    sentence="The amplifier gives no more than its supply.",
    parameters=(Parameter("voltage", "V", 0.1, 1000.0, "Vs", neutral=inf, default=40.0),),
)

CURRENT_LIMITER = Kind(
    name="current_limit",
    acts=CURRENT,
    stage=CURRENT_LIMIT,
    screening=SCREENINGS["current_limit"],
    equation="di/dt = 0 where |i| = imax and the voltage would drive it further",
    sentence="The amplifier holds the motor's current at its limit, and the voltage drops.",
    parameters=(Parameter("current", "A", 0.01, 1000.0, "imax", neutral=inf),),
)

DEAD_BAND = Kind(
    name="voltage_dead_band",
    acts=VOLTAGE,
    stage=ALWAYS,
    screening=SCREENINGS["voltage_dead_band"],
    equation="V = V - min(max(V, -d), d)",
    sentence="The amplifier lets nothing through until the voltage asked for exceeds a threshold.",
    parameters=(Parameter("voltage", "V", 0.0, 100.0, "d, half width of the band"),),
)

OFFSET = Kind(
    name="voltage_offset",
    acts=VOLTAGE,
    stage=ALWAYS,
    screening=SCREENINGS["voltage_offset"],
    equation="V = V - c",
    sentence="The amplifier gives a constant voltage too little, or too much.",
    parameters=(Parameter("voltage", "V", -100.0, 100.0, "c, what is missing at the motor"),),
)

SUPPLY = Kind(
    name="supply_droop",
    acts=VOLTAGE,
    stage=DROOP,
    per_joint=False,
    screening=SCREENINGS["supply_droop"],
    equation="V = V max(1 - c sum |i|, 0), of all joints",
    sentence="The common supply gives way under the currents of all motors together.",
    parameters=(Parameter("coefficient", "1/A", 0.0, 1.0, "c, share of the voltage lost"),),
)

INPUT_DELAY = Kind(
    name="input_delay",
    acts=VOLTAGE,
    stage=DELAYED,
    per_joint=False,
    screening=SCREENINGS["input_delay"],
    equation="V(t) = V asked for at t - T",
    sentence="Every voltage reaches its motor later than the log says.",
    parameters=(Parameter("time", "s", 0.0, 1.0, "T"),),
)

KINDS = (SATURATION, CURRENT_LIMITER, DEAD_BAND, OFFSET, SUPPLY, INPUT_DELAY)


@inlined
def saturated(p, k, voltage):
    """Voltage [V] within the supply."""
    if abs(voltage) <= p[k]:
        return voltage
    return p[k] if voltage > 0.0 else -p[k]


@inlined
def past_dead_band(p, k, voltage):
    """Voltage [V] that is left of one that has to exceed a threshold."""
    return voltage - min(max(voltage, -p[k]), p[k])


@inlined
def past_offset(p, k, voltage):
    """Voltage [V] less the constant part that is lost."""
    return voltage - p[k]


@inlined
def supply_share(p, k, i1, i2, i3):
    """Share of the supply that is left under the currents [A] of all motors."""
    return max(1.0 - p[k] * (abs(i1) + abs(i2) + abs(i3)), 0.0)


@inlined
def limited_rate(p, k, current, rate):
    """Rate of the current [A/s], zero where it would leave the limit."""
    if abs(current) < p[k] or current * rate < 0.0:
        return rate
    return 0.0


@inlined
def limited_current(p, k, current):
    """Current [A] within the limit: a finite step may end a little outside."""
    if abs(current) <= p[k]:
        return current
    return p[k] if current > 0.0 else -p[k]
