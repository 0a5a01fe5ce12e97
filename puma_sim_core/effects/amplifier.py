# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the power amplifier does to the voltage that the controller asks for."""

from __future__ import annotations

from math import inf

from ..backend import inlined
from .base import ALWAYS, CURRENT, CURRENT_LIMIT, VOLTAGE, Kind, Parameter

SATURATION = Kind(
    name="voltage_saturation", acts=VOLTAGE, stage=ALWAYS,
    equation="V = min(max(V, -Vs), Vs)",
    sentence="The amplifier gives no more than its supply.",
    parameters=(Parameter("voltage", "V", 0.1, 1000.0, "Vs", neutral=inf, default=40.0),))

CURRENT_LIMITER = Kind(
    name="current_limit", acts=CURRENT, stage=CURRENT_LIMIT,
    equation="di/dt = 0 where |i| = imax and the voltage would drive it further",
    sentence="The amplifier holds the motor's current at its limit, and the voltage drops.",
    parameters=(Parameter("current", "A", 0.01, 1000.0, "imax", neutral=inf),))

KINDS = (SATURATION, CURRENT_LIMITER)


@inlined
def saturated(p, k, voltage):
    """Voltage [V] within the supply."""
    if abs(voltage) <= p[k]:
        return voltage
    return p[k] if voltage > 0.0 else -p[k]


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
