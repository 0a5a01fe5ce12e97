# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A fault that only the trials show: a joint whose zero is wrong by more than any sensor's.

The gate sees such an offset where it makes the weight of the links wrong by much. A smaller one can
hide in the priors of the parameters until the model is fitted: then an encoder offset explains the
log better than any effect does, and is larger than one can be.
"""

from __future__ import annotations

from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS


def wrong_zeros(stages) -> list[Fault]:
    """Faults of positions by the stages of a selection."""
    found = []
    for stage in stages:
        best = max((t.gain for t in stage.trials if t.problem is None), default=0.0)
        for trial in stage.trials:
            if (
                trial.fitted is not None
                and trial.fitted.point.effects[-1].kind.shifts_zero
                and trial.problem is not None
                and trial.gain > max(best, stage.needed(trial.joint)) + CHECKS.zero_clearer
            ):
                angle = trial.fitted.point.effects[-1].values["angle"]
                found.append(
                    Fault(
                        f"position{trial.joint}",
                        None,
                        f"it is offset by about {angle:.2g} rad, which explains the log better than "
                        "any effect; expected an encoder offset of a few hundredths at most",
                    )
                )
        if found:
            break
    return found
