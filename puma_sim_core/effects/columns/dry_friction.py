# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What machines have of dry friction: coordinates in which its parameters are independent.

The level of a joint's dry friction may be anything up to a middling torque and more; its shape goes
with the level. So a shape costs as much where friction is weak as where it is strong. Each function
takes the values of an effect and the size [N.m] of a middling friction torque of its joint, and
gives a (k, 3) array: coordinates, the middle of each on machines and one deviation of it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

#: shares of the level that a shape has, middle and one deviation: difference by direction,
#: Stribeck's excess, variation over the position
_DIFFERENCE, _EXCESS, _VARIATION = (0.0, 0.3), (0.65, 0.3), (0.0, 0.4)
#: Stribeck velocity [rad/s] and stiffness of bristles [N.m/rad], median, and the factor of one
#: deviation; they stand in the objective of a fit
VELOCITY, STIFFNESS = (0.045, 1.8), (1e4, 3.8)
#: most deviations that one counts as: machines are not quite Gaussian
_FARTHEST = 3.0


def _level(torque: float, scale: float) -> tuple[float, float, float]:
    """A level [N.m] of dry friction, in the prior of all of them."""
    return torque, 0.5 * scale, scale


def _shape(torque: float, level: float, share: tuple[float, float]) -> tuple[float, float, float]:
    """A torque [N.m] beside its middle share of a level, in the prior of all of them."""
    away = torque - share[0] * level
    return away, 0.0, max(share[1] * level, abs(away) / _FARTHEST, 1e-12)


def _rate(value: float, prior: tuple[float, float]) -> tuple[float, float, float]:
    """The logarithm of what says how fast or how stiff; how far it is off, the objective says."""
    here = float(np.log(max(value, 1e-12)))
    return here, here, float(np.log(prior[1]))


def coulomb(values: Mapping[str, float], scale: float) -> np.ndarray:
    """The level."""
    return np.array([_level(values["torque"], scale)])


def asymmetric(values: Mapping[str, float], scale: float) -> np.ndarray:
    """Mean level, and half the difference by direction."""
    mean = 0.5 * (values["positive"] + values["negative"])
    half = 0.5 * (values["positive"] - values["negative"])
    return np.array([_level(mean, scale), _shape(half, mean, _DIFFERENCE)])


def stribeck(values: Mapping[str, float], scale: float) -> np.ndarray:
    """Sliding level, excess over it, and velocity."""
    return np.array(
        [
            _level(values["sliding"], scale),
            _shape(values["torque"], values["sliding"], _EXCESS),
            _rate(values["velocity"], VELOCITY),
        ]
    )


def presliding(values: Mapping[str, float], scale: float) -> np.ndarray:
    """Level, and stiffness of the bristles."""
    return np.array([_level(values["torque"], scale), _rate(values["stiffness"], STIFFNESS)])


def position(values: Mapping[str, float], scale: float) -> np.ndarray:
    """Mean level, and its variation with the cosine and the sine of the position."""
    mean, amplitude, angle = values["torque"], values["amplitude"], values["angle"]
    return np.array(
        [
            _level(mean, scale),
            _shape(amplitude * np.cos(angle), mean, _VARIATION),
            _shape(amplitude * np.sin(angle), mean, _VARIATION),
        ]
    )


def usual_stribeck(level: float) -> dict[str, float]:
    """Values of a bump of the middle shape whose friction is about a level [N.m]."""
    sliding = level / (1.0 + 0.5 * _EXCESS[0])
    return {"torque": _EXCESS[0] * sliding, "sliding": sliding, "velocity": VELOCITY[0]}
