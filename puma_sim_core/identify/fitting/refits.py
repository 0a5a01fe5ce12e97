# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Trials whose fit went astray, fitted again from where a better one shows the way (step 6)."""

from __future__ import annotations

from puma_sim_core.effects import Effect
from puma_sim_core.identify.fitting.prediction import Fitted, Point
from puma_sim_core.identify.fitting.trials import Trial, Trials, nearest
from puma_sim_core.identify.parallel import each
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.selected import LEAST_GAIN

#: gain of likelihood [nat] below which a trial is no more than a kind that it contains
_NO_MORE = 1.0


class Refits:
    """Makes trials of one problem again.

    trials : `Trials`; library : name -> kind. In the methods: fit is the `PredictionFit`; base what
    the gains are over, raw its derivatives, known_free the free parameters of its effects; short
    the short list, and trials what came of it, in the same order.
    """

    def __init__(self, trials: Trials, library):
        self.trials = trials
        self.library = library

    def nested(self, fit, base: Fitted, raw, known_free, short, trials) -> list[Trial]:
        """Trials with those that fit worse than a kind that they contain fitted again, from the
        parameters of that one on and with derivatives about it: they went astray."""

        def again(scored: Scored, trial: Trial) -> Trial:
            simpler = self._simpler(trial, trials)
            if trial.fitted is None or simpler is None or trial.fitted.objective <= simpler.objective:
                return trial
            start = Point(simpler.point.theta, trial.fitted.point.effects)
            return self._better(fit, base, raw, known_free, scored, trial, simpler.point, start)

        return each(lambda pair: again(*pair), list(zip(short, trials)))

    def revived(self, fit, base: Fitted, raw, known_free, short, trials) -> list[Trial]:
        """Trials with those that came out as no more than a kind that they contain fitted again,
        from that one with a shape as machines have it."""

        def again(scored: Scored, trial: Trial) -> Trial:
            usual = self.library[scored.name].screening.usual
            simpler = self._simpler(trial, trials)
            if (
                usual is None
                or trial.fitted is None
                or simpler is None
                or trial.fitted.objective < simpler.objective - _NO_MORE
            ):
                return trial
            *others, inner = simpler.point.effects
            last = trial.fitted.point.effects[-1]
            effect = Effect(last.kind, last.joint, {**last.values, **usual(inner.values["torque"])})
            theta = simpler.point.theta
            return self._better(
                fit, base, raw, known_free, scored, trial, Point(theta, tuple(others)), Point(theta, (*others, effect))
            )

        return each(lambda pair: again(*pair), list(zip(short, trials)))

    def _simpler(self, trial: Trial, trials) -> Fitted | None:
        """The best fit of a kind that a trial contains, on its joint."""
        return min(
            (
                t.fitted
                for t in trials
                if t.fitted is not None and t.joint == trial.joint and t.name in self.library[trial.name].contains
            ),
            key=lambda f: f.objective,
            default=None,
        )

    def resumed(self, fit, base: Fitted, raw, known_free, short, trials, stages) -> list[Trial]:
        """Trials with those that gain less than in the stage before, on another joint than what was
        named there, fitted again from where they were then: a limit acts where its value is, and
        the screening may have it where nothing shows."""
        if not stages:
            return trials
        before = {
            t.key: t
            for t in stages[-1].trials
            if t.joint != stages[-1].accepted.joint and t.problem is None and t.gain > LEAST_GAIN
        }

        def again(scored: Scored, trial: Trial) -> Trial:
            then = before.get(trial.key)
            if then is None or trial.gain >= then.gain:
                return trial
            theta, effect = then.fitted.point.theta, then.fitted.point.effects[-1]
            return self._better(
                fit,
                base,
                raw,
                known_free,
                scored,
                trial,
                Point(theta, base.point.effects),
                Point(theta, (*base.point.effects, effect)),
            )

        return each(lambda pair: again(*pair), list(zip(short, trials)))

    def _better(
        self, fit, base: Fitted, raw, known_free, scored: Scored, trial: Trial, about: Point, start: Point
    ) -> Trial:
        """A trial, or that from another start with derivatives about a point, by their gains."""
        known = fit.white(fit.derivatives(about, known_free, nearest(base, raw)))
        found = self.trials.run(fit, base, known, known_free, scored, start)
        return max(trial, found, key=lambda t: t.gain)
