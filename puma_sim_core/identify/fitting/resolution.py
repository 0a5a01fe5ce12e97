# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether an error of a position is more than that of its encoder.

An ideal encoder is wrong by half a step to each side (IEEE Std 1241). An amplitude, a gap or the twist of a shaft is
one of the machine only where it is clearly more than that: by two standard errors of its fit.
"""

import numpy as np

from puma_sim_core.effects import Effect
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting import intervals
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.settings import SELECTION


def unresolved(problem: Problem, fit: PredictionFit, fitted: Fitted, number: int) -> str | None:
    """Why the error of a position that an effect makes is none of the machine's; None where it is.

    number : of the effect in the model. A model without derivatives has no standard errors, and its values count as
    they are.
    """
    effect, unit = fitted.point.effects[number], fit.mechanism.position_unit
    step = 0.0 if effect.joint is None else float(problem.sampled.quantum[effect.joint - 1])
    for parameter in effect.kind.parameters:
        if parameter.steps is None or step <= 0.0:
            continue
        what, size, pair, spread = parameter.name, effect.values[parameter.name], (number, parameter.name), 0.0
        if fitted.jacobian is not None and pair in fitted.names:
            spread = float(intervals.deviations(fit, fitted)[0][fitted.names.index(pair)])
        if parameter.inverse:
            what = f"with a {what} of {size:.3g} {fit.mechanism.unit(parameter.unit)} a twist of"
            twist = _torque(problem, fitted.point.theta, effect) / size
            size, spread = twist, twist * spread / size
        if size - SELECTION.standard_errors * spread < parameter.steps * step:
            said = f"{what} {size:.3g}{f' +- {spread:.2g}' if spread else ''} {unit}"
            return f"{said} is not clearly more than the encoder's own error (a step of {step:.3g} {unit})"
    return None


def _torque(problem: Problem, theta: Floats, effect: Effect) -> float:
    """Amplitude [N.m or N] of the torque that moves the links of the effect's joint: of a sine with as great a mean
    square."""
    assert effect.joint is not None
    torque = problem.signals(theta).link_torque[:, effect.joint - 1]
    return float(np.sqrt(2.0 * np.mean(torque**2)))
