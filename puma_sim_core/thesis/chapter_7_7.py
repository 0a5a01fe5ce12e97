# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.7: PID control at the thesis's poses, plots 7.17 to 7.22.

7.7.1 to 7.7.3: one joint at five poses, plots 7.17 to 7.21, and maps over the workspace.

7.7.4: all three joints at once, and a search for the oscillation of plot 7.22. Everything that might sustain it
is tried by itself, with the thesis's gains and with those of the corrected model: what happens in the last half of
half a minute of standing still? Where something goes on, each joint is tried alone too: the thesis blames the coupling.
"""

from bisect import bisect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from puma_sim_core.control.linear import least_damped, radius
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis.motions import (
    FOLDED_ARM,
    HORIZONTAL,
    LIMIT,
    UPRIGHT,
    Case,
    angles,
    case,
    damping,
    gains_text,
    path,
    printed_pid,
    run,
    servo_loop,
)
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Numbers, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.ziegler_nichols import Ultimate, settings, ultimate_map

words = Words(__name__)
#: ramp of a second and a step [rad]; the thesis names ramps and steps, the plots' own path is
#: not in its text
RAMP, STEP, DURATION, STEP_AT = 0.5, 0.1, 6.0, 3.0
#: points of the maps
MAP = (27, 29)


def _responses(plant: Plant, c: Case, rows: list[Row], numbers: Numbers) -> Figure:
    """The redrawn plot of a case, with the thesis's gains and with ours; rows of Kmax and Tp before it."""
    by = np.eye(3)[c.joint - 1]
    setpoint = path(c.pose, ((0.2, 1.0, RAMP * by), (STEP_AT, 0.0, -STEP * by)), DURATION)
    own = c.ultimate(plant)
    curves: list[Curve] = []
    for key, ultimate, style in (("thesis", c.printed, "line"), ("own", own, "dashed")):
        gains = settings(ultimate)
        record = run(plant, [gains] * 3, c.pose, setpoint, alone=c.joint)
        moved, asked = (values[:, c.joint - 1] - c.pose[c.joint - 1] for values in (record.position, record.setpoint))
        curves = curves or [Curve("setpoint", record.time, asked, "steps")]
        curves.append(Curve(key, record.time, moved, style))
        over, settle = _step_quality(record.time, moved, asked)
        ratio, period = damping(plant, c.pose, c.joint, gains)
        name = f"plot {c.plot}, {words.text('gains', case=key)}"
        found = {"damping": ratio, "overshoot": over, "settling": settle}
        told = {"gains": gains_text(gains), **found, "overshoot": 100.0 * over}
        rows += [words.row("response", ours, case=what, name=name, period=period) for what, ours in told.items()]
        found["rms"] = np.sqrt(np.mean((moved - asked) ** 2))
        numbers |= {f"{c.plot}_{key}_{what}": value for what, value in found.items()}
    numbers[f"{c.plot}_ultimate"] = [own.gain, own.period]
    return words.figure("response", curves, c=c, own=own)


def _step_quality(time: np.ndarray, moved: np.ndarray, asked: np.ndarray) -> tuple[float, float]:
    """Overshoot as a share of the step, and the time [s] until 2 % of it are not left again."""
    after = time > STEP_AT
    error = (moved[after] - asked[-1]) / -STEP
    clock = time[after] - time[after][0]
    outside = np.flatnonzero(np.abs(error) > 0.02)
    last = outside[-1] + 1 if outside.size else 0
    return float(max(error.max(), 0.0)), float(clock[min(last, len(clock) - 1)])


def _ultimate_rows(plant: Plant, c: Case) -> list[Row]:
    own = c.ultimate(plant)
    return [words.row("Kmax", own.gain, c=c), words.row("Tp", own.period, case=c.plot, c=c)]


def _maps(plant: Plant, joint: int, cases: list[Case], rows: list[Row], numbers: Numbers) -> list[Heatmap]:
    """Kmax, Tp and the damping that the controllers of some cases give elsewhere."""
    # poses (n3, n2, 3) over the joint ranges [rad]
    q2, q3 = (np.linspace(*plant.arm.joint_ranges[j], n) for j, n in zip((1, 2), MAP))
    poses, axes = angles(q2, q3[:, None]), (np.degrees(q2), np.degrees(q3))
    gain, period, _ = ultimate_map(plant, joint, poses, limit=1e5)
    slow, slow_period, _ = ultimate_map(plant, joint, poses, period=0.028, delay=1, limit=1e5)
    for name, values in (("gain", gain), ("period", period), ("gain_28ms", slow), ("period_28ms", slow_period)):
        low, high = numbers[f"joint_{joint}_{name}_range"] = [values.min(), values.max()]
        rows.append(words.row("range", case=name, low=low, high=high))
    drawn = {"map of Kmax": slow, "map of Tp": period}
    maps = [words.heatmap(key, *axes, values, joint=joint) for key, values in drawn.items()]
    for c in cases:
        loop = servo_loop(plant, poses, (joint,), (settings(c.ultimate(plant)),))
        ratio, unstable = least_damped(loop, SERVO_PERIOD)[0], (radius(loop) >= 1.0).mean()
        key = f"7.7.{joint}-fixed-{c.plot}"
        low, high = numbers[f"{key}_damping_range"] = [ratio.min(), ratio.max()]
        numbers[f"{key}_unstable_share"] = unstable
        rows.append(words.row("fixed", case=unstable > 0.0, name=c.name, low=low, high=high, share=100.0 * unstable))
        maps.append(words.heatmap("map of damping", *axes, ratio, joint=joint, c=c))
    return maps


@words.experiment("7.7.1")
def joint_1(context: Context) -> Result:
    """Plots 7.17 and 7.18, and what either controller does over the workspace."""
    plant, rows, figures, numbers = Plant.of(), list[Row](), list[Figure | Heatmap](), Numbers()
    cases = [case("7.17"), case("7.18")]
    for c in cases:
        rows += _ultimate_rows(plant, c)
        figures.append(_responses(plant, c, rows, numbers))
        context.progress(0.3)
    figures += _maps(plant, 1, cases, rows, numbers)
    share = 100.0 * numbers["7.7.1-fixed-7.17_unstable_share"]
    return words.result("7.7.1", rows, figures, numbers, share=share, damping=numbers["7.7.1-fixed-7.18_damping_range"])


@words.experiment("7.7.2")
def joint_2(context: Context) -> Result:
    """Plots 7.19 and 7.20, Kmax along the range of the joint."""
    plant, rows, figures, numbers = Plant.of(), list[Row](), list[Figure | Heatmap](), Numbers()
    cases = [case("7.19"), case("7.20")]
    q2 = np.linspace(*plant.arm.joint_ranges[1], 41)
    curves = []
    for c, elbow in zip(cases, (np.pi / 2, FOLDED_ARM[2])):
        rows += _ultimate_rows(plant, c)
        gain, period, least = ultimate_map(plant, 2, angles(q2, elbow), limit=1e5)
        found = {"least_gain": least.max(), "hardest": np.degrees(q2[np.argmin(gain)])}
        found |= {f"{name}_range": [v.min(), v.max()] for name, v in (("gain", gain), ("period", period))}
        numbers |= {f"{c.plot}_{name}": value for name, value in found.items()}
        change = 1e6 * (gain.max() / gain.min() - 1.0)
        rows.append(words.row("least Kmax", found["hardest"], name=c.name, millionths=change))
        rows.append(words.row("least gain", found["least_gain"], name=c.name))
        curves.append(Curve(c.name, np.degrees(q2), gain / gain.max()))
        figures.append(_responses(plant, c, rows, numbers))
        context.progress(0.3)
    figures.append(words.figure("7.7.2-range", curves))
    figures += _maps(plant, 2, cases, rows, numbers)
    return words.result("7.7.2", rows, figures, numbers)


@words.experiment("7.7.3")
def joint_3(context: Context) -> Result:
    """Plot 7.21."""
    plant, c = Plant.of(), case("7.21")
    rows, numbers = _ultimate_rows(plant, c), Numbers()
    figures: list[Figure | Heatmap] = [_responses(plant, c, rows, numbers)]
    q3 = np.linspace(*plant.arm.joint_ranges[2], 41)
    gain, period, _ = ultimate_map(plant, 3, angles(c.pose[1], q3), limit=1e5)
    numbers |= {"gain_range": [gain.min(), gain.max()], "period_range": [period.min(), period.max()]}
    rows.append(words.row("Kmax of joint 3", low=gain.min(), high=gain.max()))
    context.progress(0.5)
    figures += _maps(plant, 3, [c], rows, numbers)
    numbers["caption_damping"], _ = damping(plant, c.pose, 3, settings(Ultimate(150.0, 0.45)))
    rows.append(words.row("caption", numbers["caption_damping"]))
    return words.result("7.7.3", rows, figures, numbers)


# ------------------------------------------------------------------------------------------ 7.7.4

#: cases that tune the three joints: arm upright
TUNED_AT = ("7.17", "7.19", "7.21")
#: how long an attempt lasts [s]
STANDING = 30.0
#: half of peak to peak [rad] below which a motion has died out; a count is a thousand times as much
STILL = 1e-7
#: greatest amplitude [rad] that passes for quiet
QUIET = 1e-3
THESIS, OWN, RESAMPLED = "thesis's gains", "gains of the corrected model", "tuned with that sampling"
Gains = Sequence[PidGains]


@dataclass(frozen=True)
class Mechanism:
    """Something that a real loop has and the linear one lacks; effects: names in the table of effects."""

    name: str
    effects: Sequence[str] = ()
    servo: dict[str, Any] = field(default_factory=dict)
    period: float = SERVO_PERIOD
    limit: float = LIMIT
    note: str = ""

    @property
    def delay(self) -> int:
        """Samples of delay."""
        return self.servo.get("delay_samples", 0)

    @property
    def plant(self) -> Plant:
        """The arm with the effects."""
        texts = [text for name in self.effects for text in words.table("effects")[name]]
        return Plant.of("bejczy", tuple(map(parse_effect, texts)))


MECHANISMS = tuple(Mechanism(**entry) for entry in words.table("mechanisms"))
#: start [rad], duration [s] and size [rad] of a move of the three joints; then they stand still
MOTIONS = {
    "ramps": (UPRIGHT, 1.0, (0.3, -0.3, 0.3)),
    "steps": (UPRIGHT, 0.0, (1.0, 1.0, -1.0)),
    "ramps, arm horizontal": (HORIZONTAL, 1.0, (0.3, -0.3, 0.3)),
}


@dataclass(frozen=True)
class Tail:
    """What is left while the setpoint stands still: half of peak to peak [rad] of each joint in the third and in the
    fourth quarter, and the mean period [s] of the greatest (0.0: none)."""

    before: tuple[float, ...]
    after: tuple[float, ...]
    period: float

    @property
    def sustained(self) -> bool:
        """Whether a joint goes on swinging as before, and not by rare jumps."""
        return self.period > 0.0 and any(b > STILL and b > 0.5 * a for a, b in zip(self.before, self.after))

    @property
    def worst(self) -> float:
        """The greatest amplitude of a joint [rad]."""
        return max(self.before + self.after)

    @property
    def loud(self) -> bool:
        """Whether it is an oscillation that would be seen."""
        return self.sustained and self.worst > QUIET

    def __str__(self) -> str:
        if self.sustained:
            return ", ".join(f"{1e3 * b:.3g}" for b in self.after) + f" mrad, period {self.period:.3g} s"
        if self.worst <= STILL:
            return "dies out"
        return f"irregular or dying: {1e3 * max(self.before):.3g} mrad, then {1e3 * max(self.after):.3g}"


def tail(record: Recording, step: float) -> Tail:
    """Of a recording of samples each `step` [s]."""
    quarter = len(record.time) // 4
    parts = record.position[-2 * quarter : -quarter], record.position[-quarter:]
    before, after = (tuple((np.ptp(part, axis=0) / 2.0).tolist()) for part in parts)
    y = record.position[-2 * quarter :, int(np.argmax(after))]
    y = y - (y.max() + y.min()) / 2.0
    # passages through a band, so that quantised motion is not counted at each of its steps
    outside = np.flatnonzero(np.abs(y) > np.ptp(y) / 8.0)
    up = outside[1:][np.diff(np.sign(y[outside])) > 0.0]
    period = (up[-1] - up[0]) / (len(up) - 1) * step if len(up) > 2 else 0.0
    return Tail(before, after, float(period))


def gains_of(plant: Plant, period: float, delay: int) -> tuple[PidGains, ...]:
    """Table 7.2 on the corrected model, arm upright, one joint at a time."""
    return tuple(settings(case(plot).ultimate(plant, period, delay)) for plot in TUNED_AT)


def attempt(
    mechanism: Mechanism, gains: Gains, motion: str, *, alone: int | None = None, duration: float = STANDING
) -> Recording | None:
    """Recording of a motion under a mechanism, or None where the state runs away."""
    start, length, by = MOTIONS[motion]
    if alone is not None:
        by = np.multiply(by, np.eye(3)[alone - 1])
    how: dict[str, Any] = {} if mechanism.period == SERVO_PERIOD else {"period": mechanism.period, "samples": 1}
    setpoint = path(start, ((0.2, length, by),), duration, how.get("period", 0.028))
    how["voltage_limit"] = mechanism.limit
    try:
        return run(mechanism.plant, gains, start, setpoint, alone, mechanism.servo, **how)
    except NonFiniteStateError:
        return None


def _search(context: Context, sets: dict[str, Gains], rows: list[Row], numbers: Numbers) -> dict[Any, Tail]:
    """Try everything; returns the tail of each (gains, mechanism, motion)."""
    found = {}
    for n, mechanism in enumerate(MECHANISMS):
        tried = dict(sets)
        if mechanism.delay or mechanism.period != SERVO_PERIOD:
            tried[RESAMPLED] = gains_of(Plant.of(), mechanism.period, mechanism.delay)
        for label, gains in tried.items():
            texts, notes = {}, [mechanism.note] if mechanism.note else []
            for motion in MOTIONS:
                record = attempt(mechanism, gains, motion)
                if record is None:
                    texts[motion] = "runs away"
                    continue
                left = found[label, mechanism.name, motion] = tail(record, mechanism.period)
                key = f"{label} | {mechanism.name} | {motion}"
                numbers[key] = [*left.after, left.period, left.sustained]
                texts[motion] = str(left)
                if left.loud:
                    going = numbers[f"{key} | alone"] = _alone(mechanism, gains, motion)
                    notes.append(words.text("alone", case=bool(going), motion=motion, joints=going))
            alike = len(set(texts.values())) == 1
            text = texts["ramps"] if alike else "; ".join(f"{motion}: {each}" for motion, each in texts.items())
            rows.append(words.row("mechanism", text, name=mechanism.name, label=label, note="; ".join(notes)))
        context.progress(0.9 * (n + 1) / len(MECHANISMS))
    return found


def _alone(mechanism: Mechanism, gains: Gains, motion: str) -> list[int]:
    """The joints that oscillate by themselves, with the others locked."""
    records = {joint: attempt(mechanism, gains, motion, alone=joint) for joint in (1, 2, 3)}
    return [joint for joint, each in records.items() if each is None or tail(each, mechanism.period).loud]


def greatest_delay(plant: Plant, gains: Gains, joints: Sequence[int], most: int = 128) -> int:
    """Samples of delay at 28/30 ms that the linear loop of some joints bears, arm upright."""
    chosen = [gains[j - 1] for j in joints]

    def unstable(delay: int) -> bool:
        return bool(radius(servo_loop(plant, UPRIGHT, joints, chosen, delay)) >= 1.0)

    return bisect(range(most), False, key=unstable) - 1


def _plots(sets: dict[str, Gains]) -> Iterator[Figure]:
    for key, (name, label) in words.table("plots").items():
        mechanism = next(m for m in MECHANISMS if m.name == name)
        record = attempt(mechanism, sets[label], "ramps", duration=4.0)
        curves = [
            Curve(f"{name} {j + 1}", record.time, values[:, j] - record.position[0, j], style)
            for j in range(3)
            for name, values, style in (("setpoint", record.setpoint, "dashed"), ("joint", record.position, "line"))
        ]
        yield words.figure(key, curves)
    # amplitude of the limit cycle against the delay, together and alone
    late = [replace(MECHANISMS[1], servo={"delay_samples": delay}) for delay in range(11)]
    curves = []
    for alone in (None, 1, 2, 3):
        left = [tail(attempt(m, sets[OWN], "ramps", alone=alone, duration=10.0), SERVO_PERIOD) for m in late]
        sizes = [1e3 * max(each.after) if each.sustained else np.nan for each in left]
        label, style = (f"joint {alone} alone", "dashed") if alone else ("all joints", "line")
        curves.append(Curve(label, np.arange(11), sizes, style))
    yield words.figure("7.7.4-delay", curves)


@words.experiment("7.7.4")
def joints(context: Context) -> Result:
    """The search, its table, and the redrawn plot."""
    plant, rows, numbers = Plant.of(), list[Row](), Numbers()
    sets = {THESIS: printed_pid(*TUNED_AT), OWN: gains_of(plant, SERVO_PERIOD, 0)}
    found = _search(context, sets, rows, numbers)
    for label, gains in sets.items():
        *alone, together = numbers[f"{label} | delay borne alone, together"] = [
            greatest_delay(plant, gains, joints) for joints in ((1,), (2,), (3,), (1, 2, 3))
        ]
        rows.append(words.row("delay", label=label, alone=alone, together=together))
    rows.insert(0, words.row("plot 7.22", str(found[THESIS, "saturation at 40 V", "ramps"])))
    left = {m.name: [found.get((THESIS, m.name, motion)) for motion in MOTIONS] for m in MECHANISMS}
    numbers["quiet_with_the_thesis_gains"] = [
        name for name, tails in left.items() if all(each and not each.loud for each in tails)
    ]
    late = found[OWN, "delay of 3 samples (2.8 ms)", "ramps"]
    values = {
        "fine": 1e6 * max(left["counts and converter"][0].after),
        "jump": 1e3 * max(t.worst for m in MECHANISMS if "friction" in m.name and m.effects for t in left[m.name]),
        "alone": min(alone),
        "together": together,
        "late": late,
        "cycle": [1e3 * a for a in late.after],
        "slow": left["sampled each 50 ms, one sample of delay"][0],
    }
    return words.result("7.7.4", rows, _plots(sets), numbers, **values)
