# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The verdict, and what is said of every hypothesis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.effects.relations import EXACT_TIES
from puma_sim_core.identify.experiment.next_experiment import next_experiment
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.trials import Key, Trial, tied
from puma_sim_core.identify.prepare import Prepared
from puma_sim_core.identify.residuals.shape import Curve, describe
from puma_sim_core.identify.residuals.unnamed import remainder
from puma_sim_core.identify.result import (
    NAMED,
    NAMED_WITH_REMAINDER,
    NOTHING_MISSING,
    UNNAMED,
    Detectable,
    Drawn,
    Errors,
    Explanation,
    Fault,
    FeedbackBias,
    Hypothesis,
    Interval,
    NamedEffect,
    Ranked,
    RuledOut,
    Shape,
)
from puma_sim_core.identify.selection.state import SelectionState, Stage
from puma_sim_core.identify.settings import RESIDUALS
from puma_sim_core.plant.mechanism import Mechanism


@dataclass(frozen=True)
class Findings:
    """What the stages found, for the explanation.

    state : the selection as it ended; curves, chance : free curves, best first, and what chance gives any of them;
    errors, residuals : tables of errors by their rows, and (N, J) voltages [V] that the "nominal", "retuned" and
    "augmented" model lack; intervals : (effect number, parameter) -> (value, low, high); source : how `explain` was
    called.
    """

    prepared: Prepared
    state: SelectionState
    curves: list[Curve]
    chance: float
    errors: dict[str, Errors]
    residuals: dict[str, np.ndarray]
    detectability: tuple[Detectable, ...]
    bias: FeedbackBias
    intervals: Mapping[tuple[int, str], tuple[float, float, float]]
    source: Mapping[str, str | None]


def fault_sentence(faults: list[Fault]) -> str:
    """The verdict on faulty data in one sentence."""
    first = faults[0]
    row = "" if first.row is None else f", row {first.row}"
    more = f", and {len(faults) - 1} more" if len(faults) > 1 else ""
    return f"The data cannot be used: {first.channel}{row}: {first.what}{more}."


def compose(found: Findings, notes: Sequence[str], common: Mapping[str, Any]) -> Explanation:
    """The explanation from all stages. common : what every explanation has, by its fields."""
    s, m = found.state, found.prepared.problem.mechanism
    names = _named(found)
    volts = found.errors["fit"].voltage_rms
    unnamed = remainder(s, found.curves, found.chance, np.asarray(volts.augmented) / volts.floor)
    curve = None
    if unnamed is None:
        verdict = NAMED if names else NOTHING_MISSING
    else:
        verdict = NAMED_WITH_REMAINDER if names else UNNAMED
        best = found.curves[: RESIDUALS.ranked_curves]
        curve = describe(unnamed, tuple((_axis_name(c), float(c.scored.gain)) for c in best))
    ties = [(Hypothesis(e.name, e.joint), other) for e in names for other in e.tied_with]
    keys = {(e.name, e.joint) for e in names}
    unseen = [d for d in found.detectability if not d.excited and (d.name, d.joint) not in keys]
    return Explanation(
        verdict,
        _sentence(verdict, names, curve, found.errors),
        names,
        found.errors,
        curve,
        (),
        found.detectability,
        next_experiment(m, ties, unseen, common["logs"][0], **found.source),
        found.bias,
        _ranking(s, names),
        (*notes, *_exact_ties(names), *_strained(m, s)),
        _drawn(found),
        m.plant(s.model.point.theta, s.model.point.effects),
        parameters=_parameters(m, s),
        **common,
    )


def _named(found: Findings) -> tuple[NamedEffect, ...]:
    s, named = found.state, []
    for number, (key, chosen) in enumerate(zip(s.keys, s.chosen)):
        effect = s.model.point.effects[number]
        units = {p.name: found.prepared.problem.mechanism.unit(p.unit) for p in effect.kind.parameters}
        parameters = {}
        for name, value in effect.values.items():
            if (number, name) in found.intervals:
                value, low, high = found.intervals[number, name]
                parameters[name] = Interval(float(value), float(low), float(high), units[name])
            elif np.isfinite(value) and _asked(effect, name):
                parameters[name] = Interval(float(value), float(value), float(value), units[name])
        own, ties, out = chosen.trial, [], []
        for t in chosen.stage.trials:
            if t.key == key or t.key in s.keys:
                continue
            if t.problem is None and tied(own, t):
                ties.append(Hypothesis(t.name, t.joint))
            else:
                out.append(RuledOut(t.name, t.joint, _because(key[0], t, own)))
        seen = {(t.name, t.joint) for t in chosen.stage.trials}
        for other, text, _ in KINDS[key[0]].look_alikes:
            joint = key[1] if other in KINDS and KINDS[other].per_joint else None
            if other in KINDS and (other, joint) not in seen and (other, joint) not in s.keys:
                out.append(RuledOut(other, joint, f"the screening gave it no evidence; {text}"))
        named.append(NamedEffect(key[0], key[1], parameters, float(own.gain), tuple(ties), tuple(out)))
    return tuple(named)


def _asked(effect: Effect, name: str) -> bool:
    """Whether a parameter that is not fitted says something: not a default of the structure."""
    spec = next(p for p in effect.kind.parameters if p.name == name)
    return spec.from_arm is None and name != "motor_share"


def _because(named: str, trial: Trial, best: Trial) -> str:
    if trial.problem is not None:
        return trial.problem
    text = KINDS[named].told_from(trial.name)
    lower = f"its evidence is lower by {best.gain - trial.gain:.0f} nat"
    return f"{lower}: {text}" if text else lower


def _axis_name(curve: Curve) -> str:
    return f"{curve.scored.name} (joint {curve.scored.joint}) {curve.way}".rstrip()


def _sentence(verdict: str, names: tuple[NamedEffect, ...], curve: Shape | None, errors: Mapping[str, Errors]) -> str:
    held = errors["held_out"].voltage_rms

    def change(joint: int | None) -> str:
        js = range(len(held.retuned)) if joint is None else [joint - 1]
        before = np.sqrt(np.mean([held.retuned[j] ** 2 for j in js]))
        after = np.sqrt(np.mean([held.augmented[j] ** 2 for j in js]))
        return f"{before:.3g} to {after:.3g} V"

    if verdict == NOTHING_MISSING:
        return (
            "Nothing is missing that this log could show: with retuned parameters the model "
            "explains it down to its noise."
        )
    if verdict == UNNAMED and curve is not None:
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
    if verdict == NAMED_WITH_REMAINDER and curve is not None:
        text += f"; beside that something over {curve.axis} of joint {curve.joint} is left that has no name"
    return text + "."


def _ranking(s: SelectionState, names: tuple[NamedEffect, ...]) -> tuple[Ranked, ...]:
    chosen = {(e.name, e.joint): e for e in names}
    rows: dict[Key, Ranked] = {}
    stage = s.history[0]
    for t in stage.trials:
        verdict = "named" if t.key in chosen else _refused(s, stage, t)
        rows[t.key] = Ranked(t.name, t.joint, float(t.gain), verdict)
    for e in names:
        rows.setdefault((e.name, e.joint), Ranked(e.name, e.joint, float(e.evidence), "named"))
    return tuple(sorted(rows.values(), key=lambda r: -r.evidence))


def _refused(s: SelectionState, stage: Stage, t: Trial) -> str:
    """Why a trial of a stage was given no name."""
    best = stage.accepted
    if t.problem is not None:
        return t.problem
    if t.key in s.retracted:
        return "retracted: it does not lower the validation error, or a free curve leaves clearly less"
    if best is not None and best.key not in s.retracted and tied(best, t):
        return "tied"
    if t.gain <= stage.needed(t.joint):
        return f"below the threshold of {stage.needed(t.joint):.0f} nat"
    if t.validation_gain <= 0.0:
        return "it does not lower the error on the validation set"
    if best is not None:
        return f"lower than {best.name} by {best.gain - t.gain:.0f} nat"
    return "too little of it acts in the validation set"


def _exact_ties(names: tuple[NamedEffect, ...]) -> list[str]:
    found = {e.name for e in names}
    return [
        f"{one} and {other} are the same in a log of voltage and position: {why}."
        for one, other, why in EXACT_TIES
        if one in found or other in found
    ]


def _strained(m: Mechanism, s: SelectionState) -> list[str]:
    """A note on parameters that went farther than their priors allow, where there are any."""
    far = (s.model.point.theta - m.start) / m.deviations
    found = [(abs(x), p.name, x) for p, x in zip(m.free, far) if abs(x) > RESIDUALS.strained]
    if not found:
        return []
    words = ", ".join(f"{name} by {x:+.1f}" for _, name, x in sorted(found, reverse=True)[: RESIDUALS.listed])
    left = len(found) - RESIDUALS.listed
    more = f" and {left} more" if left > 0 else ""
    return [
        f"Parameters are farther from their start than their priors allow ({words}{more} "
        "standard deviations): the start values are of another machine, or parameters have "
        "taken up what looks like them, such as a payload."
    ]


def _parameters(m: Mechanism, s: SelectionState) -> dict[str, tuple[float, float, str, float]]:
    theta = s.model.point.theta
    return {p.name: (float(p.value), float(value), p.unit, float(p.deviation)) for p, value in zip(m.free, theta)}


def _drawn(found: Findings) -> Drawn:
    p, stretches = found.prepared.problem, found.prepared.predictor.stretches
    s = p.sampled
    signals = p.signals(found.state.model.point.theta)
    rows = np.concatenate([stretch.time[1:] for stretch in stretches])
    log = np.concatenate([np.full(len(stretch.time) - 1, n) for n, stretch in enumerate(stretches)])
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
        found.residuals["nominal"][nearest],
        found.residuals["retuned"][nearest],
        found.residuals["augmented"][nearest],
        {name: a[kept] for name, a in series.items()},
        p.held.astype(float),
        _whiteness(found.state.model.errors, found.prepared.predictor),
    )


def _whiteness(errors: np.ndarray, predictor: Predictor) -> dict[int, tuple[np.ndarray, np.ndarray, float]]:
    """Autocorrelation of innovations (N, J) of each joint (1-based): lags [s], values, and their 95 % bound."""
    rows, step = predictor.fit_rows, predictor.step
    block = max(1, int(RESIDUALS.lag_block / step))
    out = {}
    for j in range(errors.shape[1]):
        e = np.where(rows[:, j], errors[:, j], 0.0)
        n = len(e) // block
        if n < RESIDUALS.least_lag_blocks:
            continue
        e = e[: n * block].reshape(n, block).sum(axis=1)
        most = min(int(RESIDUALS.lags / (step * block)), n // 3)
        power = float(e @ e)
        if not power > 0.0:
            continue
        acf = np.array([float(e[k:] @ e[: n - k]) / power for k in range(1, most + 1)])
        out[j + 1] = (np.arange(1, most + 1) * step * block, acf, RESIDUALS.normal_quantile / np.sqrt(n))
    return out
