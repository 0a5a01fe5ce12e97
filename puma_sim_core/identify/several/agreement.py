# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether logs of one machine, each explained alone, give the same answer: names, and sizes with their intervals.

Estimates y of one parameter, with standard errors s from their intervals, are compared by Cochran's Q,

    Q = sum (y - m)^2 / s^2,  m = sum (y / s^2) / sum (1 / s^2),

where s is that of the side of y on which m lies: y with the two halves of its interval stands for a likelihood of two
half parabolas (Barlow 2004, Asymmetric Statistical Errors, arXiv:physics/0406120), and m is the greatest of their
product. With intervals that are as wide to both sides Q has a chi-square distribution with k - 1 degrees of freedom
where the k logs have one true value (Cochran 1954, Biometrics 10, 101-129). I2 = max(0, (Q - k + 1) / Q) is the share
of the scatter that the intervals do not explain (Higgins and Thompson 2002, Statistics in Medicine 21, 1539-1558).
Where Birge's ratio sqrt(Q / (k - 1)) is above 1, the interval of the mean is wider by it (Birge 1932, Physical Review
40, 207-227).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc

from puma_sim_core.effects import KINDS
from puma_sim_core.effects.base import RATE, SIZE, STRUCTURE, Kind
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.report.text import hypothesis
from puma_sim_core.identify.result import (
    DATA_FAULT,
    Agreement,
    AgreementOfEffect,
    AgreementOfSize,
    Hypothesis,
    Interval,
)
from puma_sim_core.identify.settings import REPORT, RESIDUALS
from puma_sim_core.pages.text import listed

NAMED, TIED, NOT_EXCITED, NOT_NAMED = "named", "tied", "not excited", "not named"
#: values of what the construction gives of an effect
Law = Mapping[str, float]
#: why there is no answer of a log
_NO_ANSWER = "no answer"


def agreement(logs: Sequence[str], reports: Sequence[Mapping[str, Any] | None]) -> Agreement:
    """The comparison of reports of some logs.

    reports : mappings of report.json, None where a log could not be explained; data at fault give no answer either.
    """
    reports = [None if report is None or report["verdict"] == DATA_FAULT else report for report in reports]
    keys = dict.fromkeys((e["name"], e["joint"]) for report in reports if report for e in report["effects"])
    verdicts = tuple(_NO_ANSWER if report is None else report["verdict"] for report in reports)
    effects = tuple(_effect(Hypothesis(*key), reports) for key in keys)
    return Agreement(tuple(logs), verdicts, effects, _sentence(verdicts, effects))


def heterogeneity(
    values: Sequence[float], below: Sequence[float], above: Sequence[float]
) -> tuple[float, float, float, float]:
    """(mean, its standard error, Q, p-value) of k estimates, two at least, with errors above 0 to each side."""
    y, low, high = np.asarray(values), np.asarray(below), np.asarray(above)

    def weights(at: float) -> Floats:
        return np.where(y < at, high, low) ** -2.0

    mean = float(y[0])
    if np.ptp(y) > 0.0:
        mean = float(brentq(lambda at: weights(at) @ (at - y), y.min(), y.max(), xtol=1e-12 * np.ptp(y)))
    own = weights(mean)
    q, free = float(own @ (y - mean) ** 2), len(y) - 1
    return mean, float(own.sum() ** -0.5 * max(1.0, np.sqrt(q / free))), q, float(chdtrc(free, q))


def _effect(key: Hypothesis, reports: Sequence[Mapping[str, Any] | None]) -> AgreementOfEffect:
    states = tuple(_NO_ANSWER if report is None else _state(key, report) for report in reports)
    own = [None if report is None else _own(key, report) for report in reports]
    return AgreementOfEffect(key.name, key.joint, states, tuple(_sizes(KINDS[key.name], own)))


def _sizes(kind: Kind, own: Sequence[Mapping[str, Any] | None]) -> Iterator[AgreementOfSize]:
    """The sizes of an effect, those of one law together: a share of the weight and one of the motor's torque are two
    quantities. What happens once, such as a push, has no size that another log could give."""
    if not kind.repeatable:
        return
    laws, numbers = list[Law](), list[int | None]()
    for each in own:
        law = None if each is None else _law(kind, each)
        number = None if law is None else next((n for n, known in enumerate(laws) if _alike(law, known)), len(laws))
        if law is not None and number == len(laws):
            laws.append(law)
        numbers.append(number)
    for n, law in enumerate(laws):
        same = [each if number == n else None for each, number in zip(own, numbers)]
        for parameter in kind.parameters:
            if parameter.role in (SIZE, RATE):
                size = _size(parameter.name, [None if e is None else e["parameters"].get(parameter.name) for e in same])
                if size is not None:
                    yield replace(size, law=law)


def _law(kind: Kind, found: Mapping[str, Any]) -> Law:
    """What the construction gives of an effect."""
    structure = [p.name for p in kind.parameters if p.role is STRUCTURE and p.name in found["parameters"]]
    return {name: float(found["parameters"][name]["value"]) for name in structure}


def _alike(one: Law, other: Law) -> bool:
    """Whether two laws are the same but for what poses make of them, such as the share of the links in the inertia."""
    if one.keys() != other.keys():
        return False
    return all(abs(one[n] - other[n]) <= REPORT.same_law * max(abs(one[n]), abs(other[n])) for n in one)


def _own(key: Hypothesis, report: Mapping[str, Any]) -> Mapping[str, Any] | None:
    return next((e for e in report["effects"] if Hypothesis(e["name"], e["joint"]) == key), None)


def _state(key: Hypothesis, report: Mapping[str, Any]) -> str:
    """What a report says of an effect."""
    if _own(key, report) is not None:
        return NAMED
    if any(Hypothesis(**tie) == key for effect in report["effects"] for tie in effect["tied_with"]):
        return TIED
    unseen = {Hypothesis(d["name"], d["joint"]) for d in report["detectability"] if d["size"] == "NOT_EXCITED"}
    return NOT_EXCITED if key in unseen else NOT_NAMED


def _size(name: str, found: Sequence[Mapping[str, Any] | None]) -> AgreementOfSize | None:
    """One parameter along the logs; None where no log gives an interval."""
    given = [_interval(each) for each in found]
    sized = [each for each in given if each is not None and each.low < each.high]
    if not sized:
        return None
    unit = sized[0].unit
    if len(sized) == 1:
        return AgreementOfSize(name, unit, tuple(given))
    # a size on an end of its interval has the width of the other half
    below = [(each.value - each.low or each.high - each.low) / RESIDUALS.normal_quantile for each in sized]
    above = [(each.high - each.value or each.high - each.low) / RESIDUALS.normal_quantile for each in sized]
    mean, error, q, p = heterogeneity([each.value for each in sized], below, above)
    half = RESIDUALS.normal_quantile * error
    i2 = max(0.0, (q - len(sized) + 1) / q) if q > 0.0 else 0.0
    return AgreementOfSize(name, unit, tuple(given), Interval(mean, mean - half, mean + half, unit), q, p, i2)


def _interval(found: Mapping[str, Any] | None) -> Interval | None:
    """An estimate with finite ends."""
    if found is None or None in found["ci95"]:
        return None
    low, high = found["ci95"]
    return Interval(found["value"], low, high, found["unit"])


def _sentence(verdicts: Sequence[str], effects: Sequence[AgreementOfEffect]) -> str:
    """What the comparison comes to, in one or two sentences."""
    if not effects:
        same = "the same verdict" if len(set(verdicts)) == 1 else "different verdicts"
        return f"Explained one by one, the {len(verdicts)} logs name no effect, with {same}."
    parts = []
    for effect in effects:
        count = effect.states.count(NAMED)
        also = effect.states.count(TIED)
        words = f"{hypothesis(Hypothesis(effect.name, effect.joint), True)} is named by {count} of {len(verdicts)} logs"
        parts.append(words + (f" and tied in {also}" if also else ""))
    text = f"Explained one by one: {listed(parts)}."
    apart = [
        f"{size.parameter.replace('_', ' ')} of {hypothesis(Hypothesis(e.name, e.joint), True)}"
        for e in effects
        for size in e.sizes
        if not size.agrees
    ]
    text = f"{text} Their intervals exclude each other in {listed(apart)}." if apart else text
    return " ".join([text, *filter(None, map(_laws, effects))])


def _laws(effect: AgreementOfEffect) -> str:
    """The laws of an effect, where logs ask for different ones."""
    laws = [words for words in dict.fromkeys(size.law_words for size in effect.sizes) if words]
    if len(laws) < 2:
        return ""
    return f"They ask for different laws of {hypothesis(Hypothesis(effect.name, effect.joint), True)}: {listed(laws)}."
