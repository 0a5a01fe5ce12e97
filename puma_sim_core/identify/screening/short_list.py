# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Which hypotheses are worth a trial in the model: a short list by two screenings.

One is of filtered motion, which is quick and has no power against delays, lags and backlash; one is of the innovations,
which feedback does not bias.
"""

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from puma_sim_core.effects import Kind
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.evidence import Bank, Key, Scored
from puma_sim_core.identify.screening.hypotheses import hypotheses, open_to, screening_of
from puma_sim_core.identify.screening.search import Search
from puma_sim_core.identify.settings import SCREENING, SELECTION


class ShortList:
    """Makes the short lists of one problem.

    bank : of the screening on filtered motion (`Search.bank`); doubted : joints (1-based) whose voltage nothing coarse
    explains (`checks.channel_faults.unexplained`).
    """

    def __init__(self, search: Search, predictor: Predictor, bank: Bank, doubted: Collection[int] = ()):
        self.doubted = doubted
        self.search = search
        self.predictor = predictor
        self.library: Mapping[str, Kind] = search.library
        self.bank = bank

    def of(self, keys: Collection[Key], point: Point, causal: CausalScreen) -> list[Scored]:
        """The short list about a model with the effects `keys`."""
        slow, fast = self._slow(keys, point), self._fast(keys, causal)
        # a model of two masses a joint takes some ten times as long
        share = 2 if point.two_mass else 1
        # where the filtered motion has a large residual at the start, the fitted model may have none
        placed = {s.key: s for s in fast if screening_of(self.library[s.name]).placed}
        short = {s.key: placed.get(s.key, s) for s in slow[: SCREENING.short_list_slow // share]}
        others = [s for s in fast if s.key not in short]
        short |= {s.key: s for s in others[: SCREENING.short_list_fast // share]}
        found = [*short.values(), *self._related([*short.values()], keys, causal)]
        stretched = point.stretched(self.predictor.mechanism)
        found += self._common(found, keys, causal, stretched)
        return [*found, *self._without_power({s.key for s in found} | set(keys), keys, stretched)]

    def _slow(self, keys: Collection[Key], point: Point) -> list[Scored]:
        """By the filtered motion, best first."""
        linear = self.search.problem.linear(point.theta, point.effects)
        return [s for s in self.search.scores(linear, self.bank) if _promising(s) and s.key not in keys]

    def _fast(self, keys: Collection[Key], causal: CausalScreen) -> list[Scored]:
        """By the innovations, best first."""
        scored = [
            causal.score(kind, joint)
            for kind, joint in hypotheses(self.library.values(), self.predictor.mechanism)
            if open_to(kind, joint, keys)
        ]
        found = sorted((s for s in scored if s is not None and _promising(s)), key=lambda s: -s.gain)
        # a trial of two masses takes several times as long: what is far behind the best has its turn beside it
        least = max(SELECTION.worth_pairing, SCREENING.short_list_family * max((s.gain for s in found), default=0.0))
        return [s for s in found if s.gain > least or not self.library[s.name].two_masses]

    def _related(self, short: list[Scored], keys: Collection[Key], causal: CausalScreen) -> list[Scored]:
        """Effects that one of these contains, and effects that contain one of the best."""
        taken = {s.key for s in short} | set(keys)
        found = []
        top = max((s.gain for s in short), default=0.0)
        for s in short:
            names = list(self.library[s.name].contains)
            if s.gain > SCREENING.short_list_family * top:
                names += self._containing(s.name)
            for name in names:
                if name in self.library and (name, s.joint) not in taken:
                    scored = causal.score(self.library[name], s.joint)
                    if scored is not None and scored.values is not None:
                        taken.add(scored.key)
                        found.append(scored)
        return found

    def _containing(self, name: str) -> list[str]:
        """Effects that contain one."""
        return [k.name for k in self.library.values() if name in k.contains and not screening_of(k).generous]

    def richer(self, gains: Mapping[Key, float], taken: Collection[Key]) -> list[tuple[Kind, int | None]]:
        """(effect, joint) that contain one of the best trials. gains [nat] : of the trials that may be named; taken :
        what is in the model, or was tried."""
        least = max(SELECTION.least_gain, SCREENING.short_list_family * max(gains.values(), default=0.0))
        best = [key for key, gain in gains.items() if gain > least]
        found = dict.fromkeys((name, joint) for own, joint in best for name in self._containing(own))
        return [(self.library[name], joint) for name, joint in found if (name, joint) not in taken]

    def _common(
        self, found: list[Scored], keys: Collection[Key], causal: CausalScreen, stretched: bool
    ) -> list[Scored]:
        """Dry friction of joints where anything is missing and none is in the model.

        Parameters, a delay or an elasticity may have taken it up, so that the screening about them sees nothing of it;
        and a joint that it holds hardly moves, so that there is no velocity to screen by. stretched : whether some are
        farther than their priors allow, for then it may be missing on any joint.
        """
        rubs = {joint for name, joint in keys if self.library[name].dry}
        every = range(1, self.predictor.mechanism.joints + 1)
        missing = {s.joint for s in found} | set(every if stretched else ())
        joints = [j for j in every if j not in rubs and (j in missing or None in missing)]
        taken, more = {s.key for s in found} | set(keys), list[Scored]()
        for kind in self.library.values():
            start = screening_of(kind).common
            for joint in (j for j in joints if (kind.name, j) not in taken):
                scored = None if start is None else causal.score(kind, joint)
                # what is missing on the whole arm says nothing of a joint that does not move
                if start is not None and (scored is not None or joint in missing):
                    values = start(float(self.predictor.mechanism.torque_scale[joint - 1]))
                    occam = SCREENING.short_list_unseen_occam * len(values)
                    blind = Scored(kind.name, joint, 0.0, values=values, occam=occam)
                    more.append(blind if scored is None or scored.values is None else scored)
        return more

    def _without_power(self, taken: Collection[Key], keys: Collection[Key], stretched: bool) -> Iterator[Scored]:
        """Effects where the screening has no power.

        With two masses, one may be the noise of a joint far noisier than the others; with one, it may make a voltage
        that nothing coarse explains. Such a one drives the parameters so far that no linear screening about them shows
        it; stretched : whether some are farther than their priors allow, for then it may be on any joint.
        """
        two_mass = {joint for name, joint in keys if self.library[name].two_masses}
        volts = self.predictor.expected
        noisy = volts > SCREENING.short_list_noisy * np.median(volts)
        for joint in range(1, len(volts) + 1):
            for name, kind in self.library.items():
                values = dict(screening_of(kind).unseen)
                powerless = noisy[joint - 1] if kind.two_masses else stretched or joint in self.doubted
                if values and powerless and joint not in two_mass and (name, joint) not in taken:
                    yield Scored(name, joint, 0.0, values=values, occam=SCREENING.short_list_unseen_occam * len(values))


def _promising(scored: Scored) -> bool:
    """Whether a hypothesis is legal, and gains enough for a trial."""
    return scored.values is not None and scored.gain > SCREENING.short_list_least_screened
