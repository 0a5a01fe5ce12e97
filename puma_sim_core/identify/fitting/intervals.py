# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Confidence intervals: a sandwich about the last step, and profiles of the likelihood.

Innovations of an inexact model are not independent: the sandwich takes the scores' own covariance (Newey and West 1987,
Econometrica 55:703). No slope shows limits and gaps: each parameter is also moved to both sides, all others fitted
again, until the likelihood has fallen by as much. Where its derivatives change it falls later: the end is fitted with
new ones, and moves on as long as the likelihood has not fallen. The wider counts; but where the sandwich would reach
past the size at which the effect vanishes, the profile alone says how far it is to there: a tangent knows of no such
end.
"""

from collections.abc import Callable, Sequence

import numpy as np

from puma_sim_core.effects import Effect, Parameter
from puma_sim_core.effects.base import Role
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.point import Point, with_value
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit, Slopes
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.settings import FITTING

#: fits a model on with one parameter held; None where it cannot be run
Refit = Callable[[Point], Fitted | None]


def deviations(fit: PredictionFit, fitted: Fitted) -> tuple[Floats, Floats]:
    """(c,) standard deviations of the free parameters of the effects, in their units, and (c,) what their variance in
    the sandwich is over that by the normal matrix, 1 at least."""
    J, e = fitted.slopes, fitted.errors[fit.rows]
    p = J.shape[1] - len(fitted.names)
    precision = np.diag(np.concatenate([np.ones(p), fit.prior(fitted.point, fitted.names)[1]]))
    inverse = np.linalg.inv(J.T @ J + precision)
    # scores, summed over the joints and over short blocks of time
    row = np.nonzero(fit.rows)[0]
    block = row // max(1, int(FITTING.score_block / fit.predictor.step))
    scores = np.zeros((int(block.max()) + 1, J.shape[1]))
    np.add.at(scores, block, J * e[:, None])
    meat = scores.T @ scores
    lags = int(FITTING.longest_lag / FITTING.score_block)
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    meat += precision
    normal, sandwich = np.diag(inverse)[p:], np.diag(inverse @ meat @ inverse)[p:]
    wider = np.maximum(sandwich / normal, 1.0)
    return np.sqrt(normal * wider) * np.array(fit.sizes(fitted.point, fitted.names)), wider


def intervals(fit: PredictionFit, fitted: Fitted) -> dict[tuple[int, str], tuple[float, float, float]]:
    """(effect number, parameter) -> (value, low, high) with 95 % confidence."""
    if not fitted.names:
        return {}
    spread, wider = deviations(fit, fitted)

    def end(side: tuple[int, float]) -> float:
        k, sign = side
        return _end(fit, fitted, k, sign * float(spread[k]), float(wider[k]))

    ends = parallel_map(end, [(k, sign) for k in range(len(fitted.names)) for sign in (-1.0, 1.0)])
    return {
        (number, name): (fitted.point.effects[number].values[name], ends[2 * k], ends[2 * k + 1])
        for k, (number, name) in enumerate(fitted.names)
    }


def _free(fitted: Fitted, k: int) -> tuple[Effect, Parameter]:
    """The effect of a free parameter, and its declaration."""
    number, name = fitted.names[k]
    effect = fitted.point.effects[number]
    return effect, effect.kind.parameter(name)


def _end(fit: PredictionFit, fitted: Fitted, k: int, spread: float, wider: float) -> float:
    """One end of the interval of a free parameter. spread : standard deviation, with the sign of the side."""
    effect, spec = _free(fitted, k)
    sign = float(np.copysign(1.0, spread))
    value, blur = effect.values[spec.name], _blur(fit, effect, spec.name)
    reach = FITTING.normal_quantile * abs(spread)
    vanishing, fallen = _vanishing(effect, spec, sign), False
    if vanishing < reach:
        steps = [sign * share * vanishing for share in FITTING.vanishing_shares]
        inside, fallen, _ = _profile(fitted, k, steps, wider, _fitted_anew(fit, fitted, k))
    if fallen:
        reach = inside
    else:
        steps = [sign * share * reach for share in FITTING.profile_shares]
        along, ended, there = _profile(fitted, k, steps, wider, _fitted_on(fit, fitted, k))
        reach = max(reach, along)
        if ended:
            steps = [sign * share * reach for share in FITTING.farther_shares]
            reach = max(reach, _profile(fitted, k, steps, wider, _fitted_anew(fit, fitted, k), there)[0])
    end = value + sign * float(np.hypot(reach, FITTING.normal_quantile * blur))
    return float(max(end, min(spec.low, value)) if sign < 0.0 else min(end, max(spec.high, value)))


def _vanishing(effect: Effect, spec: Parameter, sign: float) -> float:
    """How far to one side of its value a size makes the effect vanish; infinite where it does not."""
    away = sign * (spec.neutral - effect.values[spec.name])
    return away if spec.role is Role.SIZE and not spec.inverse and away > 0.0 else np.inf


def _profile(
    fitted: Fitted, k: int, steps: Sequence[float], wider: float, refit: Refit, start: Point | None = None
) -> tuple[float, bool, Point]:
    """How far a parameter can be moved, by steps from its value, until the likelihood has fallen enough, whether it
    has, and the last model before. Each fit goes on from the one before, the first from `start`, None: the model."""
    number, _ = fitted.names[k]
    effect, spec = _free(fitted, k)
    enough, before, point = 0.5 * FITTING.normal_quantile**2 * wider, (0.0, 0.0), start or fitted.point
    for step in steps:
        reach, value = abs(step), effect.values[spec.name] + step
        if not spec.low <= value <= spec.high:
            break
        effects = with_value(point.effects, number, spec.name, value)
        if effects is None:
            break
        moved = refit(Point(point.theta, effects))
        fall = np.inf if moved is None else moved.objective - fitted.objective
        if moved is None or fall >= enough:
            # between two points the likelihood falls with the square
            low, high = np.sqrt(max(before[1], 0.0)), np.sqrt(min(fall, FITTING.greatest_fall * enough))
            part = (np.sqrt(enough) - low) / max(high - low, 1e-12)
            return float(before[0] + min(max(part, 0.0), 1.0) * (reach - before[0])), True, point
        before, point = (reach, fall), moved.point
    return before[0], False, point


def _fitted_on(fit: PredictionFit, fitted: Fitted, k: int) -> Refit:
    """Fits all but one parameter with the derivatives of the model, and new ones by the other parameters of the effect:
    of an angle and an amplitude, or of a gap and its contact, the likelihood has a curved ridge."""
    number, _ = fitted.names[k]
    first = fitted.slopes.shape[1] - len(fitted.names)
    own = [n for n, pair in enumerate(fitted.names) if pair[0] == number]
    jacobian = Slopes.of(np.delete(fitted.slopes, [first + n for n in own], axis=1))
    free = tuple(fitted.names[n] for n in own if n != k)
    frozen = tuple(pair for pair in fitted.names if pair[0] != number)
    return lambda at: fit.run(at, free, jacobian=jacobian, frozen=frozen, rounds=FITTING.profile_rounds)


def _fitted_anew(fit: PredictionFit, fitted: Fitted, k: int) -> Refit:
    """Fits all but one parameter with derivatives of its own: a joint that its friction holds has none. Two masses take
    those by the mechanism's parameters over from the fit before."""
    others = tuple(pair for n, pair in enumerate(fitted.names) if n != k)
    near: Floats | None = None

    def refit(at: Point) -> Fitted | None:
        nonlocal near
        try:
            moved, near = fit.to_end(at, others, near=near)
        except ParameterError:
            return None
        return moved

    return refit


def _blur(fit: PredictionFit, effect: Effect, name: str) -> float:
    """What a parameter is uncertain by since another one is not fitted: a backlash is as soft as its contact."""
    soft = effect.kind.parameter(name).softened_by
    if soft is None or effect.joint is None:
        return 0.0
    return float(fit.mechanism.torque_scale[effect.joint - 1]) / effect.values[soft]
