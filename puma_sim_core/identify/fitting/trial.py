# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A hypothesis as fitted in the model: what it gains, and whether it may be named."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.screening.evidence import Key, Scored
from puma_sim_core.identify.settings import FITTING

#: the first words of why no machine has a hypothesis
IMPOSSIBLE = "it would need an impossible value"


@dataclass(frozen=True)
class Trial:
    """A hypothesis fitted in the model.

    scored : the hypothesis as screened; gain [nat] : of log likelihood less the Occam factor; validation_gain [nat] :
    of log likelihood on the validation set; fitted : the model with it, None where it cannot be run; occam [nat] :
    Occam factor; problem : why it cannot be named, None where it may be; eased [nat] : what the priors of the
    mechanism's parameters gain, which are strained less with it.
    """

    scored: Scored
    gain: float
    validation_gain: float
    fitted: Fitted | None
    occam: float
    problem: str | None = None
    eased: float = 0.0

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.scored.name

    @property
    def joint(self) -> int | None:
        """Joint (1-based), None for the whole arm."""
        return self.scored.joint

    @property
    def key(self) -> Key:
        """(name, joint)."""
        return self.scored.key

    @property
    def possible(self) -> bool:
        """Whether it was fitted and may be named."""
        return self.fitted is not None and self.problem is None

    @property
    def impossible(self) -> bool:
        """Whether it was fitted, and no machine has the values that it would need."""
        return self.fitted is not None and self.problem is not None and self.problem.startswith(IMPOSSIBLE)

    @property
    def explains(self) -> bool:
        """Whether it was fitted and may be what the log has: an effect, or a wrong zero of any size, which is a fault
        of the data."""
        return self.fitted is not None and (self.problem is None or self.effect.kind.shifts_zero)

    @property
    def effect(self) -> Effect:
        """The effect as fitted."""
        return self.model.point.effects[-1]

    @property
    def model(self) -> Fitted:
        """The fitted model of a trial that could be run."""
        assert self.fitted is not None
        return self.fitted

    def beside(self, effects: Iterable[Effect]) -> Trial | None:
        """The trial as what a model with these effects lacks: under another name where its own is taken and a joint may
        have several, None where they have it, or may have no more."""
        alike = [e for e in effects if e.joint == self.joint and e.kind.name in KINDS[self.name].names]
        if any(e.kind.most == 1 or self.effect.overlaps(e) for e in alike):
            return None
        taken = {e.kind.name for e in alike}
        name = next((name for name in (self.name, *KINDS[self.name].names) if name not in taken), None)
        return None if name is None else self.named(name)

    def named(self, name: str) -> Trial:
        """The same trial under another of the names that a joint may have of its effect."""
        if name == self.name:
            return self
        point = self.model.point
        effects = (*point.effects[:-1], replace(self.effect, kind=KINDS[name]))
        model = replace(self.model, point=replace(point, effects=effects))
        return replace(self, scored=replace(self.scored, name=name), fitted=model)

    @property
    def vanishing(self) -> bool:
        """Whether it is as stiff as it may be, and nothing of it left but what it contains."""
        return self.fitted is not None and any(
            p.inverse and self.effect.values[p.name] >= p.high for p in self.effect.kind.parameters
        )

    @property
    def of_rows(self) -> float:
        """Gain of log likelihood [nat] by the rows to fit."""
        return self.gain + self.occam - self.eased

    @property
    def without_rows(self) -> float:
        """Gain [nat] that is left without what the rows to fit gain: that of the parameters' priors."""
        return min(self.gain, self.eased - self.occam)

    @property
    def untried(self) -> bool:
        """Whether next to nothing of it acts on the validation set."""
        return self.validation_gain == FITTING.untried
