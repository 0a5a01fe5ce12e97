# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The amplifier limits the motor's current."""

from functools import partial
from math import inf

from puma_sim_core.effects.base import CURRENT, SIZE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import over_resistance, positive
from puma_sim_core.effects.shared.laws import first
from puma_sim_core.effects.shared.limits import SHARP, clipped, limit_candidates
from puma_sim_core.jit import Table, inlined


@inlined
def limited_rate(p: Table, k: int, current: float, rate: float) -> float:
    """Rate of the current [A/s], zero where it would leave the limit."""
    if abs(current) < p[k] or current * rate < 0.0:
        return rate
    return 0.0


def current_limit(signals: Signals, joint: int) -> list[Candidate]:
    """The part of V - ke N qd that would drive more than R imax through the winding.

    The measured motion is that of the limited current, so that the model's current never exceeds the limit: what does
    is the voltage over the resistance, delayed by the winding's L/R.
    """
    emf = signals.emf[joint]
    if emf == 0.0:  # a current-controlled amplifier: its limit is one of the command
        return []
    drop = over_resistance(signals, joint, signals.voltage[:, joint] - emf * signals.velocity[:, joint])
    resistance = signals.volts_per_torque[joint] * _torque_per_ampere(signals, joint)
    legal = partial(positive, what="current limit", unit="A")
    through = resistance * signals.current[:, joint]
    return limit_candidates(joint, drop, 2.0 * SHARP, "current", legal, resistance, through)


def _torque_per_ampere(signals: Signals, joint: int) -> float:
    if signals.torque_per_ampere is not None:
        return float(signals.torque_per_ampere[joint])
    current, torque = signals.current[:, joint], signals.torque[:, joint]
    return float(current @ torque / max(current @ current, 1e-300))


EFFECT = Kind(
    name="current_limit",
    order=110,
    acts=CURRENT,
    equation="di/dt = 0 where |i| = imax and the voltage would drive it further",
    sentence="The amplifier holds the motor's current at its limit, and the voltage drops.",
    parameters=(Parameter("current", "A", 1e-6, 1e6, "imax", SIZE, (0.5, 20.0), neutral=inf, step=0.2),),
    laws=(Law(Point.CURRENT_RATE, limited_rate), Law(Point.CURRENT, clipped), Law(Point.CURRENT_BOUND, first)),
    screening=Screening(
        current_limit, "Fast reversals, so that back-EMF and voltage add up.", fast=True, unseen=(("current", 3.0),)
    ),
    drawn_against=("current", "torque"),
    example="current_limit:joint=2,current=3",
)
