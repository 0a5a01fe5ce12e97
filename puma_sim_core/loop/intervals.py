# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Confidence intervals that hold: the sandwich of Newey and West about the last step (step 8).

Where the model is not exact its innovations are not quite independent, and the inverse of the normal
matrix is too narrow. The sandwich takes the scores' own covariance, over lags up to a third of a
second (Newey and West 1987, Econometrica 55:703). The wider of the two counts.
"""

from __future__ import annotations

import numpy as np

from .prediction import Fitted, PredictionFit

_LONGEST = 0.33
_NORMAL = 1.959963984540054
#: blocks that scores are summed over before their lags are looked at [s]
_BLOCK = 0.02


def deviations(fit: PredictionFit, fitted: Fitted) -> np.ndarray:
    """(c,) standard deviations of the free parameters of the effects, in their units."""
    J, e = fitted.jacobian, fitted.errors[fit.rows]
    c = len(fitted.names)
    p = J.shape[1] - c
    prior = np.concatenate([np.ones(p), np.full(c, 1e-4)])
    inverse = np.linalg.inv(J.T @ J + np.diag(prior))
    # scores, summed over the joints and over short blocks of time
    row = np.nonzero(fit.rows)[0]
    block = row // max(1, int(_BLOCK / fit.predictor.step))
    scores = np.zeros((int(block.max()) + 1, J.shape[1]))
    np.add.at(scores, block, J * e[:, None])
    meat = scores.T @ scores
    lags = int(_LONGEST / _BLOCK)
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    meat += np.diag(np.concatenate([np.ones(p), np.zeros(c)]))
    sandwich = inverse @ meat @ inverse
    variance = np.maximum(np.diag(inverse), np.diag(sandwich))[p:]
    sizes = np.array(fit.sizes(fitted.point, fitted.names))
    return np.sqrt(variance) * sizes


def intervals(fit: PredictionFit, fitted: Fitted) -> dict:
    """(effect number, parameter) -> (value, low, high) with 95 % confidence."""
    if not fitted.names:
        return {}
    result = {}
    for pair, spread in zip(fitted.names, deviations(fit, fitted)):
        number, name = pair
        effect = fitted.point.effects[number]
        spec = next(p for p in effect.kind.parameters if p.name == name)
        value = effect.values[name]
        low, high = value - _NORMAL * spread, value + _NORMAL * spread
        result[pair] = (value, max(low, min(spec.low, value)), min(high, max(spec.high, value)))
    return result
