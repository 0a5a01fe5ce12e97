# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The verdict, and the explanation composed from what all stages found."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from puma_sim_core.effects import Effect
from puma_sim_core.effects.base import Role
from puma_sim_core.effects.relations import EXACT_TIES
from puma_sim_core.identify import result
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.experiment.next_experiment import next_experiment
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.prepare import Prepared
from puma_sim_core.identify.residuals.shape import Curve, describe
from puma_sim_core.identify.residuals.unnamed import remainder
from puma_sim_core.identify.selection.state import SelectionState
from puma_sim_core.identify.settings import FITTING, RESIDUALS
from puma_sim_core.identify.standing import Standing, better_by, ranking, ruled_out, standings, ties
from puma_sim_core.pages.text import effect_name, plain_quantity, scale
from puma_sim_core.plant.mechanism import Mechanism

#: signals that residuals may be drawn against
_DRAWN = ["position", "velocity", "acceleration", "voltage", "torque", "gravity_torque", "link_torque", "current"]


@dataclass(frozen=True)
class Findings:
    """What the stages found: the selection as it ended; free curves, best first, and their gain by chance; tables of
    errors by their rows; `beyond_noise` of them; (N, J) voltages [V] that the "nominal", "retuned" and "augmented"
    model lack; intervals (effect number, parameter) -> (value, low, high); how `explain` was called."""

    prepared: Prepared
    state: SelectionState
    curves: list[Curve]
    chance: float
    errors: dict[str, result.Errors]
    beyond: tuple[int, float] | None
    residuals: dict[str, Floats]
    detectability: tuple[result.Detectable, ...]
    bias: result.FeedbackBias
    intervals: Mapping[tuple[int, str], tuple[float, float, float]]
    source: Mapping[str, str | None]


def fault_sentence(faults: list[result.Fault]) -> str:
    """The verdict on faulty data in one sentence."""
    first = faults[0]
    row = "" if first.row is None else f", row {first.row}"
    more = f", and {len(faults) - 1} more fault{'s' * (len(faults) > 2)}" if len(faults) > 1 else ""
    return f"The data cannot be used: {first.channel}{row}: {first.what}{more}."


def compose(found: Findings) -> result.Explanation:
    """The explanation from all stages."""
    s, m = found.state, found.prepared.problem.mechanism
    rows = standings(s, partial(better_by, found.prepared.predictor))
    names = _named(found, rows)
    volts = found.errors["fit"].voltage_rms
    unnamed = remainder(s, found.curves, found.chance, np.asarray(volts.augmented) / volts.floor)
    beyond = found.beyond
    if unnamed is None and beyond is not None and found.curves:
        unnamed = found.curves[0]
    curve = None
    verdict = result.NAMED if names else result.NOTHING_MISSING
    # an effect that the log asks for, of a size that no machine has, is no name: but nothing is not missing either
    refuting = None if names else s.history[-1].refuting
    if unnamed is not None or beyond is not None or refuting is not None:
        verdict = result.NAMED_WITH_REMAINDER if names else result.UNNAMED
    if unnamed is not None:
        best = [(c, c.scored) for c in found.curves[: RESIDUALS.ranked_curves]]
        ranked = ((f"{s.name} (joint {s.joint}) {c.way}".rstrip(), float(s.gain)) for c, s in best)
        curve = describe(unnamed, tuple(ranked))
    alike = [(result.Hypothesis(e.name, e.joint), *e.tied_with) for e in names if e.tied_with]
    unseen = [d for d in found.detectability if not d.excited]
    return result.Explanation(
        verdict,
        _sentence(verdict, names, curve, found.errors, beyond, refuting, _without(m, s)),
        names,
        found.errors,
        curve,
        (),
        found.detectability,
        next_experiment(m, alike, unseen, found.prepared.logs[0].name, **found.source),
        found.bias,
        ranking(rows),
        (*_exact_ties(names), *_strained(m, s)),
        _drawn(found),
        s.model.point.plant(m),
        parameters=_parameters(m, s),
    )


def beyond_noise(errors: result.StageErrors, most: Floats) -> tuple[int, float] | None:
    """The joint (1-based) whose open-loop error is most beyond what noise makes, and their ratio; None where the error
    of no joint is clearly beyond it.

    most (J,) : the largest error that noise makes. What is called noise may be what a wrong model leaves; in open loop,
    over half a second, it then makes more than noise would. So a log is explained down to its noise only where these
    errors are of its size.
    """
    left = np.asarray(errors.augmented)
    ratio = np.where(most > 0.0, left / np.maximum(most, 1e-300), 0.0)
    # in a log without noise the errors of the steps are left
    ratio[~(left > RESIDUALS.open_loop_share * np.asarray(errors.nominal))] = 0.0
    if not np.nanmax(ratio, initial=0.0) > RESIDUALS.open_loop_beyond:
        return None
    return int(np.nanargmax(ratio)) + 1, float(np.nanmax(ratio))


def _named(found: Findings, rows: tuple[Standing, ...]) -> tuple[result.NamedEffect, ...]:
    """The effects of the model, the greatest evidence first."""
    s, named, mechanism = found.state, [], found.prepared.problem.mechanism
    for number, (key, chosen) in enumerate(zip(s.keys, s.chosen)):
        effect = s.model.point.effects[number]
        units = {p.name: mechanism.unit(p.unit) for p in effect.kind.parameters}
        parameters = {}
        for name, value in effect.values.items():
            if (number, name) in found.intervals or (np.isfinite(value) and _asked(effect, name)):
                middle, low, high = map(float, found.intervals.get((number, name), (value, value, value)))
                if _beyond_machines(mechanism, effect, name, high):
                    high = np.inf
                parameters[name] = result.Interval(middle, low, high, units[name])
        named.append(result.NamedEffect(*key, parameters, float(chosen.gain), ties(rows, key), ruled_out(rows, key)))
    return tuple(sorted(named, key=lambda each: -each.evidence))


def _beyond_machines(m: Mechanism, effect: Effect, name: str, high: float) -> bool:
    """Whether the end of a size's interval is more than any machine has, as of friction that holds a joint."""
    spec, screening = effect.kind.parameter(name), effect.kind.screening
    from_outside = screening is not None and screening.placed
    if spec.role is not Role.SIZE or spec.inverse or from_outside or effect.joint is None:
        return False
    plausible = m.plausible(spec, effect.joint - 1)
    return plausible is not None and high > FITTING.above_plausible * plausible[1]


def _asked(effect: Effect, name: str) -> bool:
    """Whether a parameter that is not fitted says something: not a default of the structure."""
    return effect.kind.parameter(name).from_arm is None and name != "motor_share"


def _sentence(
    verdict: str,
    names: tuple[result.NamedEffect, ...],
    curve: result.Shape | None,
    errors: Mapping[str, result.Errors],
    beyond: tuple[int, float] | None,
    refuting: Trial | None,
    without: str,
) -> str:
    if verdict == result.NOTHING_MISSING:
        return "Nothing is missing that this log could show: the retuned model explains it down to its noise."
    # not the noise of the fit, which is drawn beside the errors: that may hold what a model lacks
    most = "the most that noise of the rows could make"
    times = "" if beyond is None else f"the open-loop error of joint {beyond[0]} is {beyond[1]:.3g} times {most}"
    if verdict == result.UNNAMED and curve is None:
        why = [*([] if refuting is None else [_refuted(refuting)]), *([times] if times else [])]
        return f"Something is missing that no effect of the library explains: {'; '.join(why)}."
    if verdict == result.UNNAMED and curve is not None:
        what = f"a curve over {curve.axis} {curve.way}".rstrip()
        if curve.line_hz is not None:
            what = f"a line at {curve.line_hz:.2f} Hz"
        also = f"; {times}" if times else ""
        return f"Something is missing on joint {curve.joint} that no effect of the library explains: {what}{also}."
    parts = []
    for e in names:
        sizes = ", ".join(f"{n.replace('_', ' ')} {_estimate(i)}" for n, i in e.parameters.items())
        where = "the whole arm" if e.joint is None else f"joint {e.joint}"
        parts.append(f"{effect_name(e.name, lower=True)} on {where} ({sizes})")
    joints = [None] if any(e.joint is None for e in names) else sorted({e.joint for e in names if e.joint})
    text = (
        f"The model lacks {' and '.join(parts)}{without}; by parameters fitted to other rows of the logs the residual"
    )
    text += " " + " and ".join(_change(errors["held_out"].voltage_rms, joint) for joint in joints)
    if verdict == result.NAMED_WITH_REMAINDER and curve is not None:
        text += f"; beside that something on joint {curve.joint} over {curve.axis} is left that has no name"
    return f"{text}; {times}." if times else f"{text}."


def _without(m: Mechanism, s: SelectionState) -> str:
    """What the model would be without effects that the priors of its parameters ask for; "" where the rows do."""
    if s.retuned is None or not all(chosen.by_priors for chosen in s.chosen):
        return ""
    far = float(np.abs((s.retuned.point.theta - m.start) / m.deviations).max())
    them = "it" if len(s.chosen) == 1 else "them"
    return f"; without {them} parameters would be up to {far:.1f} standard deviations of their priors off"


def _refuted(trial: Trial) -> str:
    """An effect that explains what is missing with values that no machine has."""
    where = "the whole arm" if trial.joint is None else f"joint {trial.joint}"
    return f"{effect_name(trial.name, lower=True)} on {where} has {trial.gain:.0f} nat, but {trial.problem}"


def _estimate(interval: result.Interval) -> str:
    """An estimate, or its bound where it has but a lower one."""
    if interval.at_least:
        return f"at least {plain_quantity(interval.low, interval.unit)}"
    return plain_quantity(interval.value, interval.unit)


def _change(volts: result.StageErrors, joint: int | None) -> str:
    """The residual of a joint (1-based; None: of all) before and after."""
    rows = slice(None) if joint is None else slice(joint - 1, joint)
    before, after = (float(np.sqrt(np.mean(each[rows] ** 2))) for each in (volts.retuned, volts.augmented))
    factor, unit = scale([before, after], "V")
    where = "of all joints" if joint is None else f"of joint {joint}"
    shown = [f"{each * factor:.3g}" for each in (before, after)]
    if shown[0] == shown[1]:
        return f"{where} stays at {shown[1]} {unit}"
    return f"{where} {'falls' if after < before else 'goes'} from {shown[0]} to {shown[1]} {unit}"


def _exact_ties(names: tuple[result.NamedEffect, ...]) -> list[str]:
    found = {e.name for e in names}
    return [
        f"{one} and {other} are the same in a log of voltage and position: {why}."
        for one, other, why in EXACT_TIES
        if one in found or other in found
    ]


def _strained(m: Mechanism, s: SelectionState) -> list[str]:
    """A note on parameters that went farther than their priors allow, where there are any."""
    far = (s.model.point.theta - m.start) / m.deviations
    found = sorted(((abs(x), p.name, x) for p, x in zip(m.free, far) if abs(x) > RESIDUALS.strained), reverse=True)
    if not found:
        return []
    words = ", ".join(f"{name} by {x:+.1f}" for _, name, x in found[: RESIDUALS.listed])
    more = f" and {len(found) - RESIDUALS.listed} more parameters" if len(found) > RESIDUALS.listed else ""
    return [
        f"Parameters are farther from their start than their priors allow ({words}{more} standard deviations): the "
        "start values are of another machine, or parameters account for what looks like them, such as a payload."
    ]


def _parameters(m: Mechanism, s: SelectionState) -> dict[str, tuple[float, float, str, float]]:
    theta = s.model.point.theta
    return {p.name: (float(p.value), float(value), p.unit, float(p.deviation)) for p, value in zip(m.free, theta)}


def _drawn(found: Findings) -> result.Drawn:
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
    series = {name: getattr(signals, name) for name in _DRAWN}
    series["motor_angle"] = np.mod(signals.position * signals.gear, 2.0 * np.pi)
    series["supply_current"] = np.repeat(np.abs(signals.current).sum(axis=1, keepdims=True), s.joints, axis=1)
    return result.Drawn(
        time=np.concatenate(offsets),
        **{name: volts[nearest] for name, volts in found.residuals.items()},
        signals={name: a[kept] for name, a in series.items()},
        held_out=p.validation.astype(float),
        whiteness=_whiteness(found.state.model.errors, found.prepared.predictor),
    )


def _whiteness(errors: Floats, predictor: Predictor) -> dict[int, tuple[Floats, Floats, float]]:
    """Autocorrelation of innovations (N, J) of each joint (1-based): lags [s], values, and their 95 % bound."""
    step = predictor.step
    block = max(1, int(RESIDUALS.lag_block / step))
    n = len(errors) // block
    most = min(int(RESIDUALS.lags / (step * block)), n // 3)
    out = {}
    for j, (own, rows) in enumerate(zip(errors.T, predictor.fit_rows.T)):
        e = np.where(rows, own, 0.0)[: n * block].reshape(n, block).sum(axis=1)
        power = float(e @ e)
        if n >= RESIDUALS.least_lag_blocks and power > 0.0:
            acf = np.array([float(e[k:] @ e[: n - k]) / power for k in range(1, most + 1)])
            lags = np.arange(1, most + 1, dtype=float) * step * block
            out[j + 1] = (lags, acf, float(RESIDUALS.normal_quantile / np.sqrt(n)))
    return out
