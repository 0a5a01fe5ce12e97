# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a stage asks of a trial: its gain, in one noise or in two, and what the validation set says."""

from collections.abc import Sequence
from dataclasses import replace

from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.screening.evidence import Key
from puma_sim_core.identify.selection.state import Stage, Threshold


def in_both(
    trials: Sequence[Trial], threshold: Threshold, others: Sequence[Trial], other: Threshold
) -> tuple[tuple[Trial, ...], Threshold]:
    """Trials with gains that hold in two noises, and the threshold for them.

    A gain is the lesser of two; one that does not reach the threshold in its own noise stays, in proportion, below the
    lesser threshold as well.
    """
    least, there = threshold.least(other), {t.key: t.gain for t in others}

    def held(key: Key, gain: float, own: Threshold) -> float:
        return gain if gain > own.of(key) else gain * least.of(key) / own.of(key)

    def lesser(t: Trial) -> float:
        return min(held(t.key, t.gain, threshold), held(t.key, there.get(t.key, t.gain), other))

    return tuple(replace(t, gain=lesser(t)) for t in trials), least


def passes(trial: Trial, stage: Stage) -> bool:
    """Whether a trial of a stage may be accepted."""
    return trial.problem is None and asked_for(trial, stage)


def asked_for(trial: Trial, stage: Stage) -> bool:
    """Whether the log asks for a trial of a stage, whatever a machine may have."""
    return trial.key not in stage.unclear and trial.validation_gain > 0.0 and trial.gain > stage.needed(trial)
