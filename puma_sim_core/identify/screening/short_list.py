# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Which hypotheses are worth a trial in the model: a short list by two screenings (step 4).

One is of filtered motion, which is quick and has no eye for delays, lags and play; one is of the
innovations, which feedback cannot deceive.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.identify.fitting.prediction import Point
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.screening.search import Search
from puma_sim_core.identify.settings import SCREENING


class ShortList:
    """Makes the short lists of one problem.

    library : name -> kind; bank : of the screening on filtered motion (`Search.bank`).
    """

    def __init__(self, search: Search, predictor: Predictor, library, bank):
        self.search = search
        self.predictor = predictor
        self.library = library
        self.bank = bank

    def of(self, keys, point: Point, causal: CausalScreen) -> tuple[list[Scored], list[Scored]]:
        """The short list about a model with the effects `keys`, and all that was screened, best
        first."""
        slow, fast = self._slow(keys, point), self._fast(causal, keys)
        # a model of two masses a joint takes some ten times as long
        share = 2 if point.two_mass else 1
        short = self._completed(
            _joined(slow[: SCREENING.short_list_slow // share], fast[: SCREENING.short_list_fast // share]),
            causal,
            keys,
        )
        return short, sorted(slow + fast, key=lambda s: -s.gain)

    def _slow(self, keys, point: Point) -> list[Scored]:
        """By the filtered motion."""
        linear = self.search.problem.linear(point.theta, point.effects)
        stage = self.search.stage(linear, (), self.bank)
        return [
            s
            for s in stage.scores
            if s.values is not None and s.gain > SCREENING.short_list_least_screened and (s.name, s.joint) not in keys
        ]

    def _fast(self, causal: CausalScreen, keys) -> list[Scored]:
        """By the innovations."""
        found = []
        for name, kind in self.library.items():
            for j in [None] if not kind.per_joint else range(causal.J):
                joint = None if j is None else j + 1
                if (name, joint) in keys:
                    continue
                scored = causal.score(name, joint, kind.screening.candidates(causal.signals, j))
                if (
                    scored is not None
                    and scored.values is not None
                    and scored.gain > SCREENING.short_list_least_screened
                ):
                    found.append(scored)
        return sorted(found, key=lambda s: -s.gain)

    def _completed(self, short, causal: CausalScreen, keys) -> list[Scored]:
        """The short list with what the screening has no eye for: the kinds that one which fits any
        single event contains, those that contain one of the best, and at a joint far noisier than
        the others those that may be the noise."""
        taken = {(s.name, s.joint) for s in short} | set(keys)
        found = list(short)
        top = max((s.gain for s in short), default=0.0)
        for s in short:
            richer = self.library[s.name]
            names = list(richer.contains) if richer.screening.generous else []
            if s.gain > SCREENING.short_list_family * top:
                names += [
                    name
                    for name, kind in self.library.items()
                    if s.name in kind.contains and not kind.screening.generous
                ]
            for name in names:
                if name in self.library and (name, s.joint) not in taken:
                    candidates = self.library[name].screening.candidates(causal.signals, s.joint - 1)
                    scored = causal.score(name, s.joint, candidates)
                    if scored is not None and scored.values is not None:
                        taken.add((name, s.joint))
                        found.append(scored)
        two = {joint for name, joint in keys if self.library[name].two_masses}
        volts = self.predictor.volts
        for j in np.flatnonzero(volts > SCREENING.short_list_noisy * np.median(volts)):
            for name, kind in self.library.items():
                values = dict(kind.screening.unseen)
                if values and j + 1 not in two and (name, j + 1) not in taken:
                    found.append(
                        Scored(
                            name,
                            int(j) + 1,
                            0.0,
                            0.0,
                            None,
                            None,
                            None,
                            values,
                            price=SCREENING.short_list_unseen_price * len(values),
                        )
                    )
        return found


def _joined(*rankings) -> list[Scored]:
    """All hypotheses of several rankings, each with the values of the ranking that has it first."""
    found: dict = {}
    for ranking in rankings:
        for scored in ranking:
            found.setdefault((scored.name, scored.joint), scored)
    return list(found.values())
