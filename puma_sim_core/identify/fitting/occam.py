# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Occam factors: what log evidence is less than the greatest log likelihood, for parameters that are free.

They grow with the width of the prior over what the log leaves of it (MacKay 1992, Neural Computation 4:415).
"""

import numpy as np

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.settings import FITTING


def screened(scored: Scored) -> float:
    """Occam factor [nat] by the screening."""
    count = len(scored.values or ())
    return min(max(scored.occam, FITTING.least_occam * count), FITTING.greatest_occam * count)


def factor(scored: Scored, fit: PredictionFit, fitted: Fitted) -> float:
    """Occam factor [nat] of the last effect of a fitted model, by its prior over coordinates or by the screening."""
    effect = fitted.point.effects[-1]
    coordinates = None if effect.kind.screening is None else effect.kind.screening.coordinates
    if coordinates is None or effect.joint is None:
        return screened(scored)
    number = len(fitted.point.effects) - 1
    own = [k for k, (n, _) in enumerate(fitted.names) if n == number]
    scale = float(fit.mechanism.torque_scale[effect.joint - 1])
    value, mean, deviation = coordinates(effect.values, scale).T
    sizes = fit.sizes(fitted.point, fitted.names)

    def slope(k: int) -> Floats:
        """Derivatives (k,) of the coordinates by a parameter, per size."""
        name, step = fitted.names[k][1], FITTING.coordinate_difference
        ends = [
            coordinates({**effect.values, name: effect.values[name] + sign * step * sizes[k]}, scale)[:, 0]
            for sign in (1.0, -1.0)
        ]
        return (ends[0] - ends[1]) / (2.0 * step)

    slopes = np.column_stack([slope(k) for k in own])
    covariance = slopes @ _covariance(fit, fitted, own) @ slopes.T
    return gaussian(value - mean, deviation, covariance)


def gaussian(distance: Floats, deviation: Floats, covariance: Floats) -> float:
    """Log likelihood at its best less its mean over a prior [nat].

    distance (k,) of the best from the middle of the prior, whose deviations are (k,); covariance
    (k, k) that the likelihood leaves of it. Both are Gaussian.
    """
    likely = covariance / np.outer(deviation, deviation)
    far = distance / deviation
    both = likely + np.eye(len(far))
    # a direction that the log says nothing of has no factor
    ratio = np.linalg.eigvalsh(likely)
    width = 0.5 * float(np.sum(np.log1p(1.0 / np.maximum(ratio, FITTING.least_variance_ratio))))
    if ratio[-1] < FITTING.greatest_variance_ratio:
        return width + 0.5 * float(far @ np.linalg.solve(both, far))
    # where the log says all but nothing the prior's part would be rounded away: axis by axis it is not
    ratio, axes = np.linalg.eigh(likely)
    return width + 0.5 * float(((axes.T @ far) ** 2 / (np.maximum(ratio, 0.0) + 1.0)).sum())


def _covariance(fit: PredictionFit, fitted: Fitted, own: list[int]) -> Floats:
    """(c, c) what the log leaves of some free parameters, per size, all others fitted; without their own priors."""
    J = fitted.slopes
    p = J.shape[1] - len(fitted.names)
    precision = fit.prior(fitted.point, fitted.names)[1].copy()
    precision[own] = FITTING.no_precision
    inverse = np.linalg.inv(J.T @ J + np.diag(np.concatenate([np.ones(p), precision])))
    at = p + np.array(own)
    return inverse[np.ix_(at, at)]
