# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What makes the link's reading differ from the motor's: columns of a linear model, their priors, their sizes.

With q the motor's position, l the link's, tau the torque between them, d = l - q:

    a link's sensor with a lag of first order    l + T dl/dt = q        d = -T dl/dt
    a motor's sensor with a lag                  q + T dq/dt = l        d = +T dq/dt
    one of them late by T                        l(t) = q(t - T)        d = q(t - T) - q(t); T < 0: the motor's
    a transmission that twists                   d = -tau / K
    one with backlash                            d = -(gap / 2) sign(tau)

Zeros are arbitrary, one a log, and the ratio of the readings is known to a thousandth: both are always fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.link_side.sides import Sides
from puma_sim_core.identify.result import Interval
from puma_sim_core.identify.settings import FITTING, LINK_SIDE
from puma_sim_core.plant.mechanism import Mechanism

LAG, ELASTICITY, BACKLASH = "sensor_lag", "joint_elasticity", "backlash"
LINK, MOTOR = "link", "motor"


@dataclass(frozen=True)
class Term:
    """One effect in the model.

    sensor : whose reading is late, None of other effects; law : "lag" or "delay" of these; column (m,) and the
    deviation of its coefficient's prior; shift (m,) : what the difference has beside column times coefficient.
    """

    name: str
    column: Floats
    deviation: float
    sensor: str | None = None
    law: str = ""
    shift: Floats | float = 0.0
    #: of a delay: the time about which it is linear [s]
    about: float = 0.0


def always(sides: Sides, joint: int, mechanism: Mechanism) -> tuple[Floats, Floats]:
    """(m, k) columns and (k,) deviations of what is fitted in every model: zeros of the logs, and the ratio."""
    low, high = mechanism.ranges[joint]
    zeros = (sides.segment[:, None] == np.unique(sides.segment)).astype(float)
    q = sides.motor[:, joint]
    deviations = [LINK_SIDE.offset * (high - low)] * zeros.shape[1]
    return np.column_stack([zeros, q - q.mean()]), np.array([*deviations, LINK_SIDE.ratio])


def delay(sides: Sides, joint: int, time: float) -> Term:
    """A reading that is late, linear about a time [s]: the link's where that is positive, else the motor's."""
    shift, slope = sides.late(joint, time)
    sensor = LINK if time >= 0.0 else MOTOR
    return Term(LAG, slope, LINK_SIDE.late, sensor, "delay", shift - time * slope, time)


def lag(sides: Sides, joint: int, sensor: str) -> Term:
    """A sensor with a lag of first order."""
    column = -sides.link_velocity[:, joint] if sensor == LINK else sides.velocity[:, joint]
    return Term(LAG, column, LINK_SIDE.late, sensor, "lag")


def transmission(sides: Sides, joint: int, mechanism: Mechanism) -> list[Term]:
    """Effects of the transmission, of a joint whose torque is in the log."""
    torque = sides.torque[:, joint]
    if not np.ptp(torque) > 0.0:
        return []
    stiffness = _plausible(mechanism, joint, ELASTICITY, "stiffness")[0]
    gap = _plausible(mechanism, joint, BACKLASH, "gap")[1]
    return [Term(ELASTICITY, -torque, 1.0 / stiffness), Term(BACKLASH, -0.5 * sides.flank[:, joint], gap)]


def _plausible(mechanism: Mechanism, joint: int, name: str, parameter: str) -> tuple[float, float]:
    """Plausible sizes of an effect on a machine."""
    found = KINDS[name].parameter(parameter)
    plausible = mechanism.plausible(found, joint)
    assert plausible is not None
    return plausible


def sizes(term: Term, mean: float, deviation: float, mechanism: Mechanism) -> dict[str, Interval]:
    """Parameters of an effect with their intervals by the mean and the deviation of its coefficient."""
    reach = FITTING.normal_quantile * deviation
    low, high = mean - reach, mean + reach

    def interval(name: str, of: Callable[[float], float]) -> dict[str, Interval]:
        ends = sorted(map(of, (low, high)))
        unit = mechanism.unit(KINDS[term.name].parameter(name).unit)
        return {name: Interval(of(mean), ends[0], ends[1], unit)}

    if term.name == ELASTICITY:
        # of a compliance that may be zero the stiffness has no bound
        return interval("stiffness", lambda c: 1.0 / c if c > 0.0 else np.inf)
    if term.name == BACKLASH:
        return interval("gap", lambda c: max(c, 0.0))
    backward = -1.0 if term.law == "delay" and term.sensor == MOTOR else 1.0
    return interval("time_constant", lambda c: max(backward * c, 0.0))
