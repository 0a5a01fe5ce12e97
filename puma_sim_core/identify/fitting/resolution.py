# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether an error of a position is more than that of its encoder.

An ideal encoder is wrong by half a step to each side (IEEE Std 1241). An amplitude or a gap is one of the machine only
where it is clearly more than that: by two standard errors of its fit.
"""

from puma_sim_core.identify.fitting import intervals
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.settings import SELECTION


def unresolved(fit: PredictionFit, fitted: Fitted, number: int, step: float) -> str | None:
    """Why the error of a position that an effect makes is none of the machine's; None where it is.

    number : of the effect in the model; step : of the encoder of its joint [rad or m]. A model without derivatives has
    no standard errors, and its values count as they are.
    """
    effect, unit = fitted.point.effects[number], fit.mechanism.position_unit
    for parameter in effect.kind.parameters:
        if parameter.steps is None or step <= 0.0:
            continue
        value, pair, spread = effect.values[parameter.name], (number, parameter.name), 0.0
        if fitted.jacobian is not None and pair in fitted.names:
            spread = float(intervals.deviations(fit, fitted)[0][fitted.names.index(pair)])
        if value - SELECTION.standard_errors * spread < parameter.steps * step:
            size = f"{parameter.name} {value:.3g}{f' +- {spread:.2g}' if spread else ''} {unit}"
            return f"{size} is not clearly more than the encoder's own error (a step of {step:.3g} {unit})"
    return None
