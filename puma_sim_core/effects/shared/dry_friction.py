# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Dry friction on machines: coordinates in which its parameters are independent, and priors of these.

The level of a joint's dry friction may be anything up to its nominal friction and more; its shape scales with the
level. So a shape costs as much where friction is weak as where it is strong. Each prior is (coordinate, mean, standard
deviation).
"""

import numpy as np

from puma_sim_core.effects.base import Parameter
from puma_sim_core.effects.screening import Signals
from puma_sim_core.effects.shared.columns import positive, smooth_sign

#: more times the nominal friction torque than any friction of a machine
_MOST = 12.0
#: most deviations that one counts as: machines are not quite Gaussian
_FARTHEST = 3.0


def level_parameter(name: str, meaning: str, default: float | None = None, least: float = 0.4) -> Parameter:
    """A level of dry friction as a parameter of an effect."""
    return Parameter(name, "N.m", 0.0, 500.0, meaning, plausible=(least, 40.0), default=default)


def level(torque: float, what: str, scale: float) -> float:
    """A fitted level [N.m], where a machine of nominal friction `scale` [N.m] may have it; Illegal otherwise."""
    return positive(torque, what, "N.m", _MOST * scale)


def direction_of(signals: Signals, joint: int) -> np.ndarray:
    """Direction (n,) of motion, smooth about reversals."""
    return smooth_sign(signals.velocity[:, joint], signals.velocity_noise[joint])


def level_prior(torque: float, scale: float) -> tuple[float, float, float]:
    """A level [N.m] of dry friction, in the prior of all of them."""
    return torque, 0.5 * scale, scale


def shape_prior(torque: float, level: float, share: tuple[float, float]) -> tuple[float, float, float]:
    """A torque [N.m] beside its middle share of a level, in the prior of all of them."""
    away = torque - share[0] * level
    return away, 0.0, max(share[1] * level, abs(away) / _FARTHEST, 1e-12)


def rate_prior(value: float, prior: tuple[float, float]) -> tuple[float, float, float]:
    """The logarithm of what says how fast or how stiff; how far it is off, the objective says."""
    here = float(np.log(max(value, 1e-12)))
    return here, here, float(np.log(prior[1]))
