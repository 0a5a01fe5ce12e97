# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the choice of effects leaves behind: its stages, and the models that it ended with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.fitting.trials import Trial
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.held_out import Model

#: least gain [nat] of a name, whatever the placebos say
LEAST_GAIN = 16.0
#: share of the first effect's gain that a further one must reach: below it stands what the model of
#: the first one is not exact in
LEAST_SHARE = 0.015
#: least gain [nat] of a name that does not act on any row kept back, and least share of the first
#: effect's gain if it is a further one
LEAST_UNTRIED, UNTRIED_SHARE = 25.0, 0.03


@dataclass
class Stage:
    """One stage: trials best first, the threshold [nat] of a name by chance, the base that gains
    are over, and what the screenings said; first: by joint (None: the whole arm) the gain [nat] of
    the effect that was named first, of which a further one must reach a share."""

    trials: list[Trial]
    threshold: float
    base: Fitted
    screened: list[Scored]
    weighting: Weighting
    accepted: Trial | None = None
    placebo: float = 0.0
    first: dict[int | None, float] = field(default_factory=dict)

    def needed(self, joint: int | None) -> float:
        """Least gain [nat] of a name on a joint (1-based; None: the whole arm)."""
        return max(self.threshold, LEAST_SHARE * self.first.get(joint, 0.0))

    def needed_untried(self, joint: int | None) -> float:
        """The same of a name that does not act on any row kept back."""
        return max(self.needed(joint), LEAST_UNTRIED, UNTRIED_SHARE * self.first.get(joint, 0.0))


def entered(stages: list[Stage], key: tuple) -> Stage | None:
    """The stage by which an effect entered; None of one that replaced another."""
    return next((stage for stage in stages if stage.accepted is not None and stage.accepted.key == key), None)


@dataclass(frozen=True)
class Selected:
    """The outcome: retuned model, final model with its free parameters, all stages, and the effects
    that were taken out again since they did not lower the error held out."""

    retuned: Fitted
    final: Fitted
    keys: tuple
    stages: list[Stage]
    weighting: Weighting
    prices: dict = field(default_factory=dict)
    #: of each effect that took the place of another: the stage by which that one had entered, and
    #: its gain [nat] over the model without it
    swapped: dict = field(default_factory=dict)
    retracted: tuple = ()

    @property
    def model(self) -> Model:
        """The final model."""
        return Model(self.final, self.weighting)

    @property
    def retuned_model(self) -> Model:
        """The model with its parameters fitted and no more."""
        return Model(self.retuned, self.weighting)

    def tried(self, key: tuple) -> tuple[Stage, Trial]:
        """The stage by which a chosen effect, or the one that it replaced, entered, and its trial
        there with the gain that it has."""
        stage = entered(self.stages, key) or self.swapped[key][0]
        own = next(t for t in stage.trials if t.key == key)
        return stage, replace(own, gain=self.gain_of(key))

    def gain_of(self, key: tuple) -> float:
        """Gain [nat] of a chosen effect when it entered."""
        stage = entered(self.stages, key)
        return self.swapped[key][1] if stage is None else stage.accepted.gain
