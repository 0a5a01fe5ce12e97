# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How an effect is looked for in a measured log: what its column functions read and return.

A screening function of a kind takes `Signals` and a joint, and gives its candidates: regressor
columns, one set for each point of a grid over the parameters that the torque is not linear in.
Coefficients of the columns have a Gaussian prior; `values` turns fitted coefficients into the
parameters of the effect, or into the reason why they are no legal ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

#: units of a column before its coefficient: torque at the joint, or voltage at the motor
TORQUE_COLUMN, VOLTAGE_COLUMN = "torque", "voltage"


@dataclass(frozen=True)
class Signals:
    """A log as the screening reads it: evenly spaced, filtered without shift in time.

    Arrays are (n, J): n samples, J joints; units rad (m for a slide), N.m (N), V, A, s.

    time (n,), step : evenly spaced times and their distance.
    segment (n,) : number of the stretch of record that a row belongs to; nothing is continuous
        across stretches.
    voltage : commanded, averaged over the hold about each time.
    position, velocity, acceleration : of the motor-side encoder over the gear ratio.
    link_torque : D qdd + C + G of the links alone, without the motor's inertia.
    gravity_torque : G.
    torque : all that the motor must give by the model: link_torque + Ia qdd + H qd.
    current : torque / (N kt), or the measured one.
    enable : 1.0 where the drive is on.
    link_inertia : diagonal of D; motor_inertia (J,): Ia; viscous (J,): H.
    volts_per_torque (J,) : k = R / (N kt); lag (J,): L/R [s]; emf (J,): ke N [V.s/rad].
    gear (J,) : N, 1 where there is none.
    torque_scale (J,) : nominal friction torque, the unit of priors.
    velocity_noise (J,) : standard deviation of `velocity`.
    quantum (J,) : step of the encoder in `position`, 0.0 where none was found.
    gravity_tilt : for arms, (n, J, 2): change of gravity torque per rad of base tilt about x and y.
    payload_torque : for arms, function z -> (n, J): torque of 1 kg at (0, 0, z) of the last link.
    ranges : ((low, high), ...) of the joints.
    inertia (n, J, J) : D(q) of the links; without it, joints do not shake each other.
    position_gradient (n, J, J) : [:, i, j] is the change of `torque` of joint i per rad of joint
        j, at the same velocities and accelerations; without it, no encoder offset is looked for.
    residual (n, J) : what is left of the voltage V - Vhat after the best explanation so far;
        without it, no impulse is looked for.
    torque_per_ampere (J,) : N kt; without it, taken from `torque` and `current`.
    """

    time: np.ndarray
    step: float
    segment: np.ndarray
    voltage: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    link_torque: np.ndarray
    gravity_torque: np.ndarray
    torque: np.ndarray
    current: np.ndarray
    enable: np.ndarray
    link_inertia: np.ndarray
    motor_inertia: np.ndarray
    viscous: np.ndarray
    volts_per_torque: np.ndarray
    lag: np.ndarray
    emf: np.ndarray
    gear: np.ndarray
    torque_scale: np.ndarray
    velocity_noise: np.ndarray
    quantum: np.ndarray
    ranges: tuple[tuple[float, float], ...]
    gravity_tilt: np.ndarray | None = None
    payload_torque: Callable[[float], np.ndarray] | None = None
    inertia: np.ndarray | None = None
    position_gradient: np.ndarray | None = None
    residual: np.ndarray | None = None
    torque_per_ampere: np.ndarray | None = None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.position.shape[1]


@dataclass(frozen=True)
class Candidate:
    """Regressor columns of one effect at one grid point.

    columns : (joint 0-based, unit, (n,) values) -> for p coefficients a list of p columns, each a
        mapping {joint: (n,) array}; an effect of one joint has one entry a column, an effect of the
        whole arm one a joint. unit : TORQUE_COLUMN (torque that the effect takes: it then costs
        k (1 + L/R d/dt) of it in volts) or VOLTAGE_COLUMN (part of V - Vhat).
    mean, deviation : (p,) prior of the coefficients.
    values : coefficients (p,) -> parameters of the effect {name: value}; raises `Illegal` with a
        reason where the sign or size is impossible.
    grid : values of the parameters that the columns are not linear in, for reports.
    fixed : True where the coefficients have to come out at their `mean` (1.00 for a saturation).
    tried : number of grid points of which this one was kept as the best by a look at the residual
        (places of an impulse): its evidence counts less by the logarithm of it.
    """

    columns: tuple[dict[int, np.ndarray], ...]
    unit: str
    mean: np.ndarray
    deviation: np.ndarray
    values: Callable[[np.ndarray], dict[str, float]]
    grid: dict[str, float]
    fixed: bool = False
    tried: int = 1


class Illegal(Exception):
    """Fitted coefficients that the effect cannot have: the text says which and why."""


@dataclass(frozen=True)
class Screening:
    """How an effect is found in a log.

    candidates : (signals, joint 0-based or None for the whole arm) -> its candidates, none where the log cannot show
        it.
    excitation : sentence on the motion that shows it.
    size : parameter whose size tells what is detectable; None: the first one with a plausible range.
    generous : share of its evidence that a special case of it may lack: above 0 for an effect that fits whatever
        happened once.
    unseen : (parameter, value) pairs from which it is tried in the model at a joint that is far noisier than the
        others, though no candidate asks for it: its own impacts may be that noise. Without any it is not.
    coordinates : (values of the effect, nominal friction torque of its joint) -> (k, 3) array: coordinates that
        machines have about independently of each other, the mean of each and its standard deviation. The Occam factor
        of its coefficients is taken by these; None: by the prior of its candidates.
    usual : level [N.m] of the dry friction that it contains -> values of the effect with a shape as machines have it:
        where the shape has come out as nothing, no slope says how fast it would be, and a fit begins there again.
    fitted : (names of parameters, values, lowest and highest position of the log) -> those that the log tells of.
    fast : its columns are made of accelerations or rates of voltage, which are noise wherever the motion does not
        stand out of it.
    """

    candidates: Callable[[Signals, Any], list[Candidate]]
    excitation: str
    size: str | None = None
    generous: float = 0.0
    unseen: tuple[tuple[str, float], ...] = ()
    coordinates: Callable[[Mapping[str, float], float], np.ndarray] | None = None
    usual: Callable[[float], dict[str, float]] | None = None
    fitted: Callable[[list[str], Mapping[str, float], float, float], list[str]] | None = None
    fast: bool = False
