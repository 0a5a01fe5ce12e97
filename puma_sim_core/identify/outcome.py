# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The verdict, and what is said of every hypothesis (steps 5 and 9)."""

from __future__ import annotations

import time as clock

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.effects.relations import EXACT_TIES
from puma_sim_core.identify.experiment.next_experiment import next_experiment
from puma_sim_core.identify.fitting.trials import tied
from puma_sim_core.identify.residuals.shape import describe
from puma_sim_core.identify.result import (
    NAMED,
    NAMED_WITH_REMAINDER,
    NOTHING_MISSING,
    UNNAMED,
    Drawn,
    Explanation,
    Fault,
    Hypothesis,
    Interval,
    NamedEffect,
    Ranked,
    RuledOut,
)
from puma_sim_core.identify.selection.selected import LEAST_GAIN

#: least gain [nat] of a remainder, and its least share of the gain of the first effect
_REMAINDER, _REMAINDER_SHARE = 20.0, 0.003
#: a residual of so many times its floor is no mere inexactness of what was named
_LEFT = 1.5
#: what a remainder's gain must exceed the placebos' greatest by
_FACTOR, _MARGIN = 1.3, 3.0
#: what a free curve may leave of a joint's squared innovations, in terms of what the names leave,
#: to be preferred: where they leave a remainder, as of measured logs, which neither explains to the
#: end, and where they leave none
_CLEARLY_LESS, _LESS_THAN_ALL = 0.9, 0.985
#: deviations of its prior from which on a parameter counts as strained
_STRAINED = 4.0
#: lags of the whiteness plot [s]
_LAGS = 0.5


def fault_sentence(faults: list[Fault]) -> str:
    """The verdict on faulty data in one sentence."""
    first = faults[0]
    row = "" if first.row is None else f", row {first.row}"
    more = f", and {len(faults) - 1} more" if len(faults) > 1 else ""
    return f"The data cannot be used: {first.channel}{row}: {first.what}{more}."


def compose(
    analysis, errors, residuals, shapes, chance, detect, bias, spread, model, notes, begin, common
) -> Explanation:
    """The explanation from all stages."""
    s = analysis.selected
    names = _named(analysis, spread)
    volts = errors["fit"].voltage_rms
    unnamed = remainder(s, shapes, chance, np.asarray(volts.augmented) / volts.floor)
    if unnamed is None:
        verdict = NAMED if names else NOTHING_MISSING
    else:
        verdict = NAMED_WITH_REMAINDER if names else UNNAMED
    curve = None
    if unnamed is not None:
        ranking = tuple((_axis_name(c), float(c.scored.gain)) for c in shapes[:8])
        curve = describe(unnamed, ranking)
    m = analysis.mechanism
    ties = [(Hypothesis(e.name, e.joint), other) for e in names for other in e.tied_with]
    found = {(e.name, e.joint) for e in names}
    unseen = [d for d in detect if not d.excited and (d.name, d.joint) not in found]
    return Explanation(
        verdict,
        _sentence(verdict, names, curve, errors, m),
        names,
        errors,
        curve,
        (),
        tuple(detect),
        next_experiment(m, ties, unseen, common["logs"][0], **analysis.source),
        bias,
        _ranking(s, names),
        (*notes, *_exact_ties(names), *_strained(m, s)),
        _drawn(analysis, residuals),
        model,
        parameters=_parameters(m, s),
        seconds=clock.perf_counter() - begin,
        **common,
    )


def _named(analysis, spread) -> tuple[NamedEffect, ...]:
    s = analysis.selected
    named = []
    for number, key in enumerate(s.keys):
        effect = s.final.point.effects[number]
        units = {p.name: analysis.mechanism.unit(p.unit) for p in effect.kind.parameters}
        parameters = {}
        for name, value in effect.values.items():
            if (number, name) in spread:
                value, low, high = spread[number, name]
                parameters[name] = Interval(float(value), float(low), float(high), units[name])
            elif np.isfinite(value) and _asked(effect, name):
                parameters[name] = Interval(float(value), float(value), float(value), units[name])
        stage, own = s.tried(key)
        ties, out = [], []
        for t in stage.trials:
            if t.key == key or t.key in s.keys:
                continue
            if t.problem is None and tied(own, t):
                ties.append(Hypothesis(t.name, t.joint))
            else:
                out.append(RuledOut(t.name, t.joint, _because(key[0], t, own)))
        seen = {(t.name, t.joint) for t in stage.trials}
        for other, text, _ in effect.kind.look_alikes:
            joint = key[1] if other in KINDS and KINDS[other].per_joint else None
            if other in KINDS and (other, joint) not in seen and (other, joint) not in s.keys:
                out.append(RuledOut(other, joint, f"the screening gave it no evidence; {text}"))
        named.append(NamedEffect(key[0], key[1], parameters, float(own.gain), tuple(ties), tuple(out)))
    return tuple(named)


def _asked(effect, name) -> bool:
    """Whether a parameter that is not fitted says something: not a default of the structure."""
    spec = next(p for p in effect.kind.parameters if p.name == name)
    return spec.from_arm is None and name != "motor_share"


def _because(named: str, trial, best) -> str:
    if trial.problem is not None:
        return trial.problem
    text = KINDS[named].told_from(trial.name)
    lower = f"its evidence is lower by {best.gain - trial.gain:.0f} nat"
    return f"{lower}: {text}" if text else lower


def no_name_stands(curve: float, names: float, price: float, remains: bool) -> bool:
    """Whether a free curve about the model without names is to be preferred to the names.

    curve, names : sums of squares of the white innovations of its joint that they leave; price
    [nat] of the curve's heights; remains : whether something remains after the names.
    """
    if remains:
        return curve < _CLEARLY_LESS * names
    # names that explain all leave but noise, of which no curve leaves less
    return curve < _LESS_THAN_ALL * names and 0.5 * (names - curve) - price > LEAST_GAIN


def remainder(s, shapes, chance, left):
    """The best free curve about what was chosen, where it is more than chance and more than
    inexactness; else None."""
    if not shapes:
        return None
    first = max((s.gain_of(key) for key in s.keys), default=0.0)
    inexact = left[shapes[0].scored.joint - 1] < _LEFT
    need = max(_REMAINDER, _FACTOR * chance + _MARGIN, _REMAINDER_SHARE * first * inexact)
    return shapes[0] if shapes[0].scored.gain > need else None


def _axis_name(curve) -> str:
    return f"{curve.scored.name} (joint {curve.scored.joint}) {curve.way}".rstrip()


def _sentence(verdict, names, curve, errors, mechanism) -> str:
    held = errors["held_out"].voltage_rms

    def change(joint):
        js = range(len(held.retuned)) if joint is None else [joint - 1]
        before = np.sqrt(np.mean([held.retuned[j] ** 2 for j in js]))
        after = np.sqrt(np.mean([held.augmented[j] ** 2 for j in js]))
        return f"{before:.3g} to {after:.3g} V"

    if verdict == NOTHING_MISSING:
        return (
            "Nothing is missing that this log could show: with retuned parameters the model "
            "explains it down to its noise."
        )
    if verdict == UNNAMED:
        what = (
            f"a line at {curve.line_hz:.2f} Hz"
            if curve.line_hz is not None
            else f"a curve over {curve.axis} {curve.way}".rstrip()
        )
        return f"Something is missing on joint {curve.joint} that no effect of the library explains: {what}."
    parts = []
    for e in names:
        where = "the whole arm" if e.joint is None else f"joint {e.joint}"
        size = ", ".join(
            f"{n} {i.value:.3g} {i.unit if i.unit != '1' else ''}".strip() for n, i in e.parameters.items()
        )
        parts.append(f"{e.name} on {where} ({size}; the error on held-out rows falls from {change(e.joint)})")
    text = f"The model lacks {' and '.join(parts)}"
    if verdict == NAMED_WITH_REMAINDER:
        text += f"; beside that something over {curve.axis} of joint {curve.joint} is left that has no name"
    return text + "."


def _ranking(s, names) -> tuple[Ranked, ...]:
    chosen = {(e.name, e.joint): e for e in names}
    rows = {}
    for stage in s.stages[:1]:
        for t in stage.trials:
            verdict = "named" if t.key in chosen else _refused(s, stage, t)
            rows[t.key] = Ranked(t.name, t.joint, float(t.gain), verdict)
    for e in names:
        rows.setdefault((e.name, e.joint), Ranked(e.name, e.joint, float(e.evidence), "named"))
    return tuple(sorted(rows.values(), key=lambda r: -r.evidence))


def _refused(s, stage, t) -> str:
    """Why a trial of a stage was given no name."""
    best = stage.accepted
    if t.problem is not None:
        return t.problem
    if t.key in s.retracted:
        return "retracted: the error held out is not lower with it, or a free curve leaves clearly less"
    if best is not None and best.key not in s.retracted and tied(best, t):
        return "tied"
    if t.gain <= stage.needed(t.joint):
        return f"below the threshold of {stage.needed(t.joint):.0f} nat"
    if t.held_gain <= 0.0:
        return "it does not lower the error on the rows kept back"
    if best is not None:
        return f"lower than {best.name} by {best.gain - t.gain:.0f} nat"
    return "too little of it acts where rows were kept back"


def _exact_ties(names) -> list[str]:
    found = {e.name for e in names}
    return [
        f"{one} and {other} are the same in a log of voltage and position: {why}."
        for one, other, why in EXACT_TIES
        if one in found or other in found
    ]


def _strained(m, s) -> list[str]:
    """A note on parameters that went farther than their priors allow, where there are any."""
    far = (s.final.point.theta - m.start) / m.deviations
    found = [(abs(x), p.name, x) for p, x in zip(m.free, far) if abs(x) > _STRAINED]
    if not found:
        return []
    words = ", ".join(f"{name} by {x:+.1f}" for _, name, x in sorted(found, reverse=True)[:4])
    more = f" and {len(found) - 4} more" if len(found) > 4 else ""
    return [
        f"Parameters are farther from their start than their priors allow ({words}{more} "
        "standard deviations): the start values are of another machine, or parameters have "
        "taken up what looks like them, such as a payload."
    ]


def _parameters(m, s) -> dict:
    theta = s.final.point.theta
    return {p.name: (float(p.value), float(value), p.unit, float(p.deviation)) for p, value in zip(m.free, theta)}


def _drawn(analysis, residuals) -> Drawn:
    p = analysis.problem
    s, theta = p.sampled, analysis.selected.final.point.theta
    signals = p.signals(theta)
    rows = np.concatenate([stretch.time[1:] for stretch in analysis.predictor.stretches])
    log = np.concatenate([np.full(len(stretch.time) - 1, n) for n, stretch in enumerate(analysis.predictor.stretches)])
    kept, nearest, start, offsets = p.kept, np.empty(len(p.kept), dtype=int), 0.0, []
    for number, part in enumerate(p.stretches):
        own = np.flatnonzero(log == number)
        time = s.time[kept[part]]
        nearest[part] = own[np.clip(np.searchsorted(rows[own], time), 0, len(own) - 1)]
        offsets.append(start + time - time[0])
        start = offsets[-1][-1] + 1.0
    series = {
        "position": signals.position,
        "velocity": signals.velocity,
        "acceleration": signals.acceleration,
        "voltage": signals.voltage,
        "torque": signals.torque,
        "gravity_torque": signals.gravity_torque,
        "link_torque": signals.link_torque,
        "current": signals.current,
        "motor_angle": np.mod(signals.position * signals.gear, 2.0 * np.pi),
        "supply_current": np.repeat(np.abs(signals.current).sum(axis=1, keepdims=True), s.joints, axis=1),
    }
    return Drawn(
        np.concatenate(offsets),
        *(residuals[name][nearest] for name in ("nominal", "retuned", "augmented")),
        {name: a[kept] for name, a in series.items()},
        p.held.astype(float),
        _whiteness(analysis),
    )


def _whiteness(analysis) -> dict:
    """Autocorrelation of the final innovations of each joint (1-based)."""
    errors, rows = analysis.selected.final.errors, analysis.predictor.fit_rows
    step = analysis.predictor.step
    block = max(1, int(0.01 / step))
    out = {}
    for j in range(errors.shape[1]):
        e = np.where(rows[:, j], errors[:, j], 0.0)
        n = len(e) // block
        if n < 20:
            continue
        e = e[: n * block].reshape(n, block).sum(axis=1)
        most = min(int(_LAGS / (step * block)), n // 3)
        power = float(e @ e)
        if not power > 0.0:
            continue
        acf = np.array([float(e[k:] @ e[: n - k]) / power for k in range(1, most + 1)])
        out[j + 1] = (np.arange(1, most + 1) * step * block, acf, 1.96 / np.sqrt(n))
    return out
