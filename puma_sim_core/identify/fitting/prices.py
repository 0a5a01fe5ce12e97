# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the free coefficients of a hypothesis cost, by what machines have (step 4).

A richer kind fits any log better than a simpler one that it contains. What its evidence is less
for that depends on how much wider the prior of its coefficients is than the log leaves them.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects import Effect
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.screening.evidence import Scored

#: least and greatest price [nat] of a coefficient by the screening: what that promised is no
#: measure of it where the fit then goes far from there
_LEAST, _MOST = 1.5, 6.0
#: what is told of a parameter, per its size, where the log tells nothing
_NOTHING = 1e-8
#: step of a difference, as a share of the size of a parameter
_STEP = 1e-4


def screened(scored: Scored) -> float:
    """Price [nat] by the screening."""
    count = len(scored.values)
    return min(max(scored.price, _LEAST * count), _MOST * count)


def price(scored: Scored, fit: PredictionFit, fitted: Fitted) -> float:
    """Price [nat] of the last effect of a fitted model: of a kind that says what coordinates of it
    machines have, by these and what the log leaves of them, else by the screening."""
    effect = fitted.point.effects[-1]
    coordinates = effect.kind.screening.coordinates
    if coordinates is None:
        return screened(scored)
    number = len(fitted.point.effects) - 1
    own = [k for k, (n, _) in enumerate(fitted.names) if n == number]
    scale = float(fit.mechanism.torque_scale[effect.joint - 1])
    value, mean, deviation = coordinates(effect.values, scale).T
    slopes = np.column_stack(
        [
            _slope(coordinates, effect, fitted.names[k][1], size, scale)
            for k, size in zip(own, np.array(fit.sizes(fitted.point, fitted.names))[own])
        ]
    )
    covariance = slopes @ _covariance(fit, fitted, own) @ slopes.T
    return gaussian(value - mean, deviation, covariance)


def gaussian(distance: np.ndarray, deviation: np.ndarray, covariance: np.ndarray) -> float:
    """Log likelihood at its best less its mean over a prior [nat].

    distance (k,) of the best from the middle of the prior, whose deviations are (k,); covariance
    (k, k) that the likelihood leaves of it. Both are Gaussian.
    """
    likely = covariance / np.outer(deviation, deviation)
    far = distance / deviation
    both = likely + np.eye(len(far))
    # of a direction that the log says nothing of, there is nothing to pay
    ratio = np.linalg.eigvalsh(likely)
    width = 0.5 * float(np.sum(np.log1p(1.0 / np.maximum(ratio, 1e-12))))
    return width + 0.5 * float(far @ np.linalg.solve(both, far))


def _slope(coordinates, effect: Effect, name: str, size: float, scale: float) -> np.ndarray:
    """(k,) derivatives of the coordinates by a parameter, per size."""
    ends = [
        coordinates({**effect.values, name: effect.values[name] + sign * _STEP * size}, scale)[:, 0]
        for sign in (1.0, -1.0)
    ]
    return (ends[0] - ends[1]) / (2.0 * _STEP)


def _covariance(fit: PredictionFit, fitted: Fitted, own: list[int]) -> np.ndarray:
    """(c, c) what the log leaves of some free parameters of the effects, all others fitted, per
    size; their own priors tell nothing here."""
    J = fitted.jacobian
    p = J.shape[1] - len(fitted.names)
    told = fit.prior(fitted.point, fitted.names)[1].copy()
    told[own] = _NOTHING
    inverse = np.linalg.inv(J.T @ J + np.diag(np.concatenate([np.ones(p), told])))
    at = p + np.array(own)
    return inverse[np.ix_(at, at)]
