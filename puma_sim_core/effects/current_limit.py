# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The amplifier limits the motor's current."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import CURRENT, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, recursion, stretches, visible
from puma_sim_core.effects.shared.limits import SHARP, beyond, limits_of
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass


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


@inlined
def bound(p, k):
    """Greatest current [A]."""
    return p[k]


def current_limit(signals: Signals, joint: int) -> list[Candidate]:
    """The part of V - ke N qd that would drive more than R imax through the winding.

    The measured motion is that of the limited current, so that the model's current never exceeds
    the limit: what does is the voltage over the resistance, delayed by the winding's L/R.
    """
    emf = signals.emf[joint]
    if emf == 0.0:  # a current-controlled amplifier: its limit is one of the command
        return []
    drop = _winding(signals, joint, signals.voltage[:, joint] - emf * signals.velocity[:, joint])
    resistance = signals.volts_per_torque[joint] * _torque_per_ampere(signals, joint)
    found = []
    for limit, reach in limits_of(drop):
        excess = beyond(drop, limit)

        def values(c, limit=limit):
            return {"current": positive((limit + c[1]) / resistance, "current limit", "A")}

        columns = on_joint(joint, excess, -np.sign(excess))
        if visible(columns):
            found.append(
                candidate(
                    columns,
                    [1.0, 0.0],
                    [2.0 * SHARP, reach],
                    values,
                    {"current": float(limit / resistance)},
                    VOLTAGE_COLUMN,
                    fixed=True,
                )
            )
    return found


def _torque_per_ampere(signals: Signals, joint: int) -> float:
    if signals.torque_per_ampere is not None:
        return float(signals.torque_per_ampere[joint])
    current, torque = signals.current[:, joint], signals.torque[:, joint]
    return float(current @ torque / max(current @ current, 1e-300))


def _winding(signals: Signals, joint: int, volts: np.ndarray) -> np.ndarray:
    """Voltage over the resistance of a winding to which `volts` is applied, from the steady
    current of the first sample on."""
    lag = float(signals.lag[joint])
    if lag <= 0.0:
        return volts
    out = np.empty_like(volts)
    kept = float(np.exp(-signals.step / lag))
    for part in stretches(signals):
        # the voltage between two samples is about the mean of both
        driving = volts[part].copy()
        driving[1:] = 0.5 * (volts[part][1:] + volts[part][:-1])
        out[part] = recursion(np.full_like(driving, kept), (1.0 - kept) * driving, float(driving[0]))
    return out


EFFECT = Kind(
    name="current_limit",
    order=110,
    acts=CURRENT,
    equation="di/dt = 0 where |i| = imax and the voltage would drive it further",
    sentence="The amplifier holds the motor's current at its limit, and the voltage drops.",
    parameters=(Parameter("current", "A", 0.01, 1000.0, "imax", neutral=inf, plausible=(0.5, 20.0), step=0.2),),
    laws=(Law(Point.CURRENT_RATE, limited_rate), Law(Point.CURRENT, limited_current), Law(Point.CURRENT_BOUND, bound)),
    screening=Screening(current_limit, excitation="Fast reversals, so that back-EMF and voltage add up.", fast=True),
    drawn_against=("current", "torque"),
    example="current_limit:joint=2,current=3",
)
