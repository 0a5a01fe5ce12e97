# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Confidence intervals that hold: a sandwich about the last step, and profiles (step 8).

Where the model is not exact its innovations are not quite independent, and the inverse of the
normal matrix is too narrow. The sandwich takes the scores' own covariance, over lags up to a third
of a second (Newey and West 1987, Econometrica 55:703). Limits and gaps are not seen by any slope:
each parameter is also moved to both sides, with all others fitted again, until the likelihood has
fallen by what its variance in the sandwich asks for. The widest counts.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects import Effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.fitting.prediction import Fitted, Point, PredictionFit
from puma_sim_core.identify.parallel import each

_LONGEST = 0.33
_NORMAL = 1.959963984540054
#: blocks that scores are summed over before their lags are looked at [s]
_BLOCK = 0.02
#: where a profile is looked at, over the reach of the sandwich, which is the least that counts
_SHARES = (1.0, 1.5, 2.5, 4.0)


def deviations(fit: PredictionFit, fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """(c,) standard deviations of the free parameters of the effects, in their units, and (c,) what
    their variance in the sandwich is over that by the normal matrix, 1 at least."""
    J, e = fitted.jacobian, fitted.errors[fit.rows]
    p = J.shape[1] - len(fitted.names)
    _, told = fit.prior(fitted.point, fitted.names)
    inverse = np.linalg.inv(J.T @ J + np.diag(np.concatenate([np.ones(p), told])))
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
    meat += np.diag(np.concatenate([np.ones(p), told]))
    normal, sandwich = np.diag(inverse)[p:], np.diag(inverse @ meat @ inverse)[p:]
    wider = np.maximum(sandwich / normal, 1.0)
    return np.sqrt(normal * wider) * np.array(fit.sizes(fitted.point, fitted.names)), wider


def intervals(fit: PredictionFit, fitted: Fitted) -> dict:
    """(effect number, parameter) -> (value, low, high) with 95 % confidence."""
    if not fitted.names:
        return {}
    known = list(zip(*deviations(fit, fitted)))
    sides = [(k, sign) for k in range(len(known)) for sign in (-1.0, 1.0)]
    ends = each(lambda side: _end(fit, fitted, *side, *known[side[0]]), sides)
    return {
        (number, name): (fitted.point.effects[number].values[name], *ends[2 * k : 2 * k + 2])
        for k, (number, name) in enumerate(fitted.names)
    }


def _end(fit, fitted, k, sign, spread, wider) -> float:
    """One end of the interval of a free parameter."""
    number, name = fitted.names[k]
    effect = fitted.point.effects[number]
    spec = next(p for p in effect.kind.parameters if p.name == name)
    value, blur = effect.values[name], _blur(fit, effect, name)
    reach = max(_NORMAL * spread, _profile(fit, fitted, k, sign, spread, wider))
    end = value + sign * float(np.hypot(reach, _NORMAL * blur))
    return max(end, min(spec.low, value)) if sign < 0.0 else min(end, max(spec.high, value))


def _profile(fit, fitted, k, sign, spread, wider) -> float:
    """How far a parameter can be moved in one direction until the likelihood has fallen enough."""
    number, name = fitted.names[k]
    effect = fitted.point.effects[number]
    spec = next(p for p in effect.kind.parameters if p.name == name)
    others = tuple(pair for n, pair in enumerate(fitted.names) if n != k)
    at = fitted.jacobian.shape[1] - len(fitted.names) + k
    known = np.delete(fitted.jacobian, at, axis=1)
    enough, before = 0.5 * _NORMAL**2 * wider, (0.0, 0.0)
    for share in _SHARES:
        reach = share * _NORMAL * spread
        value = effect.values[name] + sign * reach
        if not spec.low <= value <= spec.high:
            break
        effects = list(fitted.point.effects)
        try:
            effects[number] = Effect(effect.kind, effect.joint, {**effect.values, name: value})
        except ParameterError:
            break
        moved = fit.run(Point(fitted.point.theta, tuple(effects)), (), known=known, known_free=others, rounds=3)
        fall = np.inf if moved is None else moved.objective - fitted.objective
        if fall >= enough:
            # between two points the likelihood falls with the square
            low, high = np.sqrt(max(before[1], 0.0)), np.sqrt(min(fall, 1e6 * enough))
            part = (np.sqrt(enough) - low) / max(high - low, 1e-12)
            return before[0] + min(max(part, 0.0), 1.0) * (reach - before[0])
        before = reach, fall
    return before[0]


def _blur(fit, effect, name) -> float:
    """What a parameter is uncertain by since another one is not fitted: the edges of backlash are as
    soft as its contact, whose stiffness is that of no machine in particular."""
    soft = effect.kind.parameter(name).softened_by
    return float(fit.mechanism.torque_scale[effect.joint - 1]) / effect.values[soft] if soft else 0.0
