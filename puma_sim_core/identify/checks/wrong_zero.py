# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A fault that only the trials show: a joint whose zero is wrong by more than any sensor's.

The gate sees such an offset where it makes the weight of the links wrong by much. A smaller one can hide in the priors
of the parameters until the model is fitted: then an encoder offset explains the log better than any effect does, and is
larger than one can be. Where the position jumped for good, its zero is another one from there on.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.selection.state import Stage
from puma_sim_core.identify.settings import CHECKS


def wrong_zeros(stages: Iterable[Stage], cuts: Sequence[Fault] = ()) -> list[Fault]:
    """Faults of positions by the stages of a selection, those of the first stage that has any. cuts : faults of rows
    that the logs were cut at.

    Where an effect that no machine has fits better still, an offset is not what is wrong: of a voltage that has nothing
    to do with the motion some offset leaves less, too.
    """
    for stage in stages:
        best = max((t.gain for t in stage.trials if t.problem is None), default=0.0)
        most = max((t.gain for t in stage.trials if not KINDS[t.name].shifts_zero), default=0.0)
        found = [
            Fault.of(
                f"position{t.joint}",
                None,
                f"it is offset by about {t.effect.values['angle']:.2g} rad, more than any effect explains",
                "an encoder offset of a few hundredths at most",
            )
            for t in stage.trials
            if t.fitted is not None
            and t.problem is not None
            and KINDS[t.name].shifts_zero
            and t.gain > max(best, stage.threshold.of(t.key)) + CHECKS.zero_clearer
            and t.gain > most
        ]
        if found:
            return [_since(fault, cuts) for fault in found]
    return []


def _since(fault: Fault, cuts: Sequence[Fault]) -> Fault:
    """A wrong zero as the jump that it comes from, if there is one: a cut at which no row was left out."""
    jump = next((cut for cut in cuts if cut.channel == fault.channel and cut.row is not None and not cut.rows), None)
    if jump is None:
        return fault
    return replace(jump, what=f"{jump.what}. With the rows on both sides {fault.what}")
