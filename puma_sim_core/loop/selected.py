# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the choice of effects leaves behind: its stages, and the models that it ended with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from .evidence import Scored
from .held_out import Model
from .prediction import Fitted
from .trials import Trial
from .weighting import Weighting


@dataclass
class Stage:
    """One stage: trials best first, the threshold of a name, the base that gains are over, and what
    the screenings said."""

    trials: list[Trial]
    threshold: float
    base: Fitted
    screened: list[Scored]
    weighting: Weighting
    accepted: Trial | None = None
    placebo: float = 0.0


def entered(stages: list[Stage], key: tuple) -> Stage | None:
    """The stage by which an effect entered; None of one that replaced another."""
    return next((stage for stage in stages if stage.accepted is not None
                 and stage.accepted.key == key), None)


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
