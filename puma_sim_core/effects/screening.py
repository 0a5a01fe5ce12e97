# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How an effect is looked for in a measured log: what its screening function reads and returns.

The function takes `Signals` and a joint, and gives candidates: regressor columns, one set for each point of a grid over
the parameters that the torque is not linear in. Coefficients of the columns have a Gaussian prior; `values` turns
fitted coefficients into parameters of the effect, or into the reason why they are no legal ones.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

#: units of a column before its coefficient: torque at the joint, or voltage at the motor
TORQUE_COLUMN, VOLTAGE_COLUMN = "torque", "voltage"
#: parameters of an effect by name, and arrays (n,) by joint, 0-based: columns, or voltages
Values = Mapping[str, float]
#: lowest and highest position [rad or m]
Span = tuple[float, float]
ByJoint = dict[int, np.ndarray]


@dataclass(frozen=True)
class Signals:
    """A log as the screening reads it: evenly spaced, filtered without shift in time.

    Arrays are (n, J) unless said otherwise: n samples, J joints; units rad (m for a slide), N.m (N), V, A, s.
    """

    time: np.ndarray  #: (n,)
    step: float  #: distance of the times
    segment: np.ndarray  #: (n,) number of the row's stretch of record; nothing is continuous across stretches
    voltage: np.ndarray  #: commanded, averaged over the hold about each time
    position: np.ndarray  #: of the motor-side encoder over the gear ratio, as velocity and acceleration are
    velocity: np.ndarray
    acceleration: np.ndarray
    link_torque: np.ndarray  #: D qdd + C + G of the links alone, without the motor's inertia
    gravity_torque: np.ndarray  #: G
    torque: np.ndarray  #: all that the motor must give by the model: link_torque + Ia qdd + H qd
    current: np.ndarray  #: torque / (N kt), or the measured one
    enable: np.ndarray  #: 1.0 where the drive is on
    link_inertia: np.ndarray  #: diagonal of D
    motor_inertia: np.ndarray  #: (J,) Ia
    viscous: np.ndarray  #: (J,) H
    volts_per_torque: np.ndarray  #: (J,) k = R / (N kt)
    lag: np.ndarray  #: (J,) L/R [s]
    emf: np.ndarray  #: (J,) ke N [V.s/rad]
    gear: np.ndarray  #: (J,) N, 1 where there is none
    torque_scale: np.ndarray  #: (J,) nominal friction torque, the unit of priors
    velocity_noise: np.ndarray  #: (J,) standard deviation of `velocity`
    quantum: np.ndarray  #: (J,) step of the encoder in `position`, 0.0 where none was found
    ranges: tuple[tuple[float, float], ...]  #: (low, high) of the joints
    gravity_tilt: np.ndarray | None = None  #: for arms, (n, J, 2): change of G per rad of base tilt about x and y
    #: for arms, place (x, y, z) [m] in the frame of link 3 -> torque of 1 kg there
    payload_torque: Callable[[tuple[float, float, float]], np.ndarray] | None = None
    inertia: np.ndarray | None = None  #: (n, J, J) D(q) of the links; without it, joints do not shake each other
    #: (n, J, J) change of `torque` of joint i per rad of joint j, all else equal; without it, no offset is sought
    position_gradient: np.ndarray | None = None
    residual: np.ndarray | None = None  #: V - Vhat after the best explanation so far; without it, no impulse is sought
    #: (J,) share of the links in the inertia by the start values; without it, by `link_inertia` and `motor_inertia`
    mesh_share: np.ndarray | None = None
    torque_per_ampere: np.ndarray | None = None  #: (J,) N kt; without it, taken from `torque` and `current`
    library_sized: bool = False  #: of `Mechanism`: whether the sizes of the library's tables are the machine's own

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.position.shape[1]


@dataclass(frozen=True)
class Candidate:
    """Regressor columns of one effect at one grid point."""

    columns: tuple[ByJoint, ...]  #: one a coefficient, with an entry for each joint that the effect is seen on
    #: TORQUE_COLUMN (torque that the effect takes: it costs k (1 + L/R d/dt) of it in volts) or VOLTAGE_COLUMN (part of
    #: V - Vhat)
    unit: str
    mean: np.ndarray  #: (p,) of the prior of the coefficients
    deviation: np.ndarray  #: (p,) of the prior of the coefficients
    #: coefficients (p,) -> parameters of the effect; raises `Illegal` where sign or size is impossible
    values: Callable[[np.ndarray], dict[str, float]]
    grid: dict[str, float]  #: values of the parameters that the columns are not linear in, for reports
    fixed: bool = False  #: the coefficients have to come out at their `mean` (1.00 for a saturation)
    #: number of grid points of which this was the best by a look at the residual: its logarithm lessens the evidence
    tried: int = 1


def reached(given: Span, seen: Span) -> Span:
    """Span that a joint can reach: its range, and what a log visits where that is more or no range is known."""
    if not np.isfinite(given).all() or given[1] <= given[0]:
        return seen
    return min(given[0], seen[0]), max(given[1], seen[1])


class Illegal(Exception):
    """Fitted coefficients that the effect cannot have: the text says which and why."""


@dataclass(frozen=True)
class Screening:
    """How an effect is found in a log."""

    #: (signals, joint 0-based or None for the whole arm) -> its candidates, none where the log cannot show it
    candidates: Callable[[Signals, Any], list[Candidate]]
    excitation: str  #: sentence on the motion that shows it
    size: str | None = None  #: parameter that tells what is detectable; None: the first one with a plausible range
    generous: float = 0.0  #: share of its evidence that a special case may lack: above 0 where it fits any single event
    #: (parameter, value) pairs from which it is tried where the screening has no power: at a joint far noisier than
    #: others, whose noise may be impacts, and, with one mass, at one whose voltage nothing coarse explains, or at all
    #: where parameters went beyond their priors (a limit)
    unseen: tuple[tuple[str, float], ...] = ()
    #: (values, nominal friction torque) -> (k, 3) array for the Occam factor: coordinates that are about independent on
    #: machines, with mean and standard deviation; None: it is taken by the candidates
    coordinates: Callable[[Values, float], np.ndarray] | None = None
    #: level [N.m] of the dry friction that it contains -> values with shapes as machines have them: a fit begins at the
    #: best of these again where the shape has come out as nothing
    usual: Callable[[float], tuple[dict[str, float], ...]] | None = None
    #: (names of parameters, values, lowest and highest position of the log) -> those that the log tells of
    fitted: Callable[[list[str], Values, float, float], list[str]] | None = None
    #: (values, span of the log, span that the joint can reach) -> why no machine has these, None where one may
    illegal: Callable[[Values, Span, Span], str | None] | None = None
    #: (nominal friction torque [N.m]) -> values from which it is tried where anything is missing, whatever screening
    #: says: what all but every geared drive has; None: it is not
    common: Callable[[float], dict[str, float]] | None = None
    #: its candidates lie where a residual has them: that of the fitted model rather than of filtered motion
    placed: bool = False
    fast: bool = False  #: its columns are made of accelerations or rates of voltage, which may be noise
    #: (signals, joint 0-based) -> further candidates, of coefficient 1 and without columns, that the screening of the
    #: innovations runs in the model: a light rotor does not move as the columns have it. None: it goes by the columns
    runs: Callable[[Signals, int], list[Candidate]] | None = None
