# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Section 7.7.4: all three joints at once, and a search for the oscillation of plot 7.22.

Everything that might sustain an oscillation is tried by itself, with the thesis's gains and with
those of the corrected model: what happens in the last half of half a minute of standing still?
Where something goes on, each joint is tried alone too, for the thesis blames the coupling.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from puma_sim_core.control.linear import linearised, pid_loop, radius, sampled
from puma_sim_core.dynamics.pid import PidGains
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis.motions import HORIZONTAL, UPRIGHT
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.thesis.tuning import PERIOD, SAMPLES, case, path, printed_pid, run
from puma_sim_core.tuning.ziegler_nichols import settings

#: cases that tune the three joints: arm upright
TUNED_AT = ("7.17", "7.19", "7.21")
DURATION = 30.0
#: half of peak to peak [rad] below which a motion has died out; a count is a thousand times as much
STILL = 1e-7

_COULOMB = (
    "asymmetric_coulomb_friction:joint=1,positive=24.7,negative=27.2",
    "asymmetric_coulomb_friction:joint=2,positive=13.6,negative=7.65",
    "asymmetric_coulomb_friction:joint=3,positive=7.1,negative=5.6",
)
_STICK = _COULOMB + (
    "stribeck_friction:joint=1,torque=6",
    "stribeck_friction:joint=2,torque=4",
    "stribeck_friction:joint=3,torque=2",
)
_FINE = {"encoder_counts": 1000, "converter_bits": 12}
_STOP = ("soft_stop:joint=3,upper=1.8",)


@dataclass(frozen=True)
class Mechanism:
    """Something that a real loop has and the linear one lacks."""

    name: str
    effects: tuple[str, ...] = ()
    servo: dict = field(default_factory=dict)
    period: float = SERVO_PERIOD
    limit: float = 40.0
    note: str = ""

    @property
    def delay(self) -> int:
        """Samples of delay."""
        return self.servo.get("delay_samples", 0)


def _late(samples: int, period: float = SERVO_PERIOD, name: str = "") -> Mechanism:
    return Mechanism(
        name or f"delay of {samples} samples ({samples * period * 1e3:.1f} ms)",
        servo={"delay_samples": samples},
        period=period,
    )


MECHANISMS = (
    Mechanism("no limit, no delay, no friction", limit=np.inf),
    Mechanism("saturation at 40 V"),
    Mechanism("saturation at 40 V, no anti-windup", servo={"anti_windup": False}),
    Mechanism("saturation at 15 V, no anti-windup", servo={"anti_windup": False}, limit=15.0),
    Mechanism("encoders of 1000 counts a motor turn", servo={"encoder_counts": 1000}),
    Mechanism("12-bit converter", servo={"converter_bits": 12}),
    Mechanism("counts and converter", servo=_FINE),
    Mechanism("current limit of 5 A", tuple(f"current_limit:joint={j},current=5" for j in (1, 2, 3))),
    Mechanism("stop in the way of joint 3", _STOP),
    Mechanism("Coulomb friction", _COULOMB, note="Corke and Armstrong's values"),
    Mechanism(
        "Coulomb friction that sticks more than it slides", _STICK, note="a quarter to a third more at rest, assumed"
    ),
    Mechanism("sticking friction, counts and converter", _STICK, _FINE),
    *(_late(n) for n in (1, 2, 3, 5, 10, 30)),
    _late(0, 0.028, "sampled each 28 ms"),
    _late(1, 0.028, "sampled each 28 ms, one sample of delay"),
    _late(2, 0.028, "sampled each 28 ms, two samples of delay"),
    _late(1, 0.05, "sampled each 50 ms, one sample of delay"),
    Mechanism("counts, converter, delay of 2 samples", servo={**_FINE, "delay_samples": 2}),
)

#: start [rad] and moves of the three joints; then they stand still
MOTIONS = {
    "ramps": (UPRIGHT, ((0.2, 1.0, (0.3, -0.3, 0.3)),)),
    "steps": (UPRIGHT, ((0.2, 0.0, (1.0, 1.0, -1.0)),)),
    "ramps, arm horizontal": (HORIZONTAL, ((0.2, 1.0, (0.3, -0.3, 0.3)),)),
}


@dataclass(frozen=True)
class Tail:
    """What is left while the setpoint stands still: half of peak to peak [rad] of each joint in
    the third and in the fourth quarter, and the mean period [s] of the greatest (0.0: none)."""

    before: tuple[float, float, float]
    after: tuple[float, float, float]
    period: float

    @property
    def sustained(self) -> bool:
        """Whether a joint goes on swinging as before, and not by rare jumps."""
        return self.period > 0.0 and any(b > STILL and b > 0.5 * a for a, b in zip(self.before, self.after))

    @property
    def worst(self) -> float:
        """The greatest amplitude of a joint [rad]."""
        return max(self.before + self.after)

    def __str__(self):
        if not self.sustained:
            left = f"{1e3 * max(self.before):.3g} mrad, then {1e3 * max(self.after):.3g}"
            return "dies out" if self.worst <= STILL else f"irregular or dying: {left}"
        return ", ".join(f"{1e3 * b:.3g}" for b in self.after) + f" mrad, period {self.period:.3g} s"


def tail(record, step: float) -> Tail:
    """Of a recording of samples each `step` [s]."""
    quarter = len(record.time) // 4
    a, b = record.position[-2 * quarter : -quarter], record.position[-quarter:]
    before, after = (tuple((np.ptp(part, axis=0) / 2.0).tolist()) for part in (a, b))
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


def attempt(mechanism: Mechanism, gains, motion: str, *, alone: int | None = None, duration: float = DURATION):
    """Recording of a motion under a mechanism, or None where the state runs away."""
    plant = Plant.of("bejczy", tuple(parse_effect(text) for text in mechanism.effects))
    start, moves = MOTIONS[motion]
    if alone is not None:
        moves = tuple(
            (when, length, tuple(v if j == alone else 0.0 for j, v in enumerate(by, 1))) for when, length, by in moves
        )
    fast = mechanism.period == SERVO_PERIOD
    period = PERIOD if fast else mechanism.period
    try:
        return run(
            plant,
            gains,
            start,
            path(start, moves, duration, period),
            alone=alone,
            period=period,
            samples=SAMPLES if fast else 1,
            voltage_limit=mechanism.limit,
            **mechanism.servo,
        )
    except NonFiniteStateError:
        return None


def _search(context: Context, sets, rows: list, numbers: dict) -> dict:
    """Try everything; returns the tail of each (gains, mechanism, motion)."""
    found = {}
    for n, mechanism in enumerate(MECHANISMS):
        own = (
            {}
            if mechanism.delay == 0 and mechanism.period == SERVO_PERIOD
            else {"tuned with that sampling": gains_of(Plant.of(), mechanism.period, mechanism.delay)}
        )
        for label, gains in {**sets, **own}.items():
            texts, notes = [], [mechanism.note] if mechanism.note else []
            for motion in MOTIONS:
                record = attempt(mechanism, gains, motion)
                if record is None:
                    texts.append(f"{motion}: runs away")
                    continue
                result = found[label, mechanism.name, motion] = tail(record, mechanism.period)
                key = f"{label} | {mechanism.name} | {motion}"
                numbers[key] = [*result.after, result.period, result.sustained]
                texts.append(f"{motion}: {result}")
                if result.sustained and result.worst > 1e-3:
                    going = _alone(mechanism, gains, motion)
                    numbers[f"{key} | alone"] = going
                    notes.append(
                        f"{motion}: "
                        + (
                            f"alone too: joint {', '.join(map(str, going))}"
                            if going
                            else "each joint alone comes to rest, the coupling does it"
                        )
                    )
            if len({t.split(": ", 1)[1] for t in texts}) == 1:
                texts = [texts[0].split(": ", 1)[1]]
            rows.append(Row(f"{mechanism.name}; {label}", "", None, "; ".join(texts), "; ".join(notes)))
        context.progress(0.9 * (n + 1) / len(MECHANISMS))
    return found


def _alone(mechanism: Mechanism, gains, motion: str) -> list[int]:
    """The joints that oscillate by themselves, with the others locked."""
    going = []
    for joint in (1, 2, 3):
        record = attempt(mechanism, gains, motion, alone=joint)
        if record is None or ((t := tail(record, mechanism.period)).sustained and t.worst > 1e-3):
            going.append(joint)
    return going


def greatest_delay(plant: Plant, gains, joints, most: int = 128) -> int:
    """Samples of delay at 28/30 ms that the linear loop of some joints bears, arm upright."""
    f, g = sampled(*linearised(plant, UPRIGHT, joints), SERVO_PERIOD)
    chosen = [gains[j - 1] for j in joints]
    low, high = -1, most
    while high - low > 1:
        middle = (low + high) // 2
        stable = radius(pid_loop(f, g, chosen, SERVO_PERIOD, middle)) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return low


def _delays(plant: Plant, sets, rows: list, numbers: dict) -> None:
    for label, gains in sets.items():
        alone = [greatest_delay(plant, gains, (j,)) for j in (1, 2, 3)]
        together = greatest_delay(plant, gains, (1, 2, 3))
        numbers[f"{label} | delay borne alone, together"] = [*alone, together]
        rows.append(
            Row(
                f"greatest delay of the linear loop; {label}",
                "samples of 28/30 ms",
                None,
                f"alone {', '.join(map(str, alone))}; together {together}",
                "up to 127 looked at",
            )
        )


def _figures(sets):
    thesis, own = sets["thesis's gains"], sets["gains of the corrected model"]
    plain, late = MECHANISMS[1], next(m for m in MECHANISMS if m.delay == 3)
    slow = next(m for m in MECHANISMS if m.period == 0.05)
    for key, mechanism, gains, title, note in (
        (
            "7.22",
            plain,
            thesis,
            "Control of all joints with the thesis's gains, 40 V",
            "The oscillation of the thesis's plot does not appear.",
        ),
        (
            "7.22-delay",
            late,
            own,
            "The same with the corrected model's gains, three samples of delay",
            "Each joint alone comes to rest.",
        ),
        (
            "7.22-50ms",
            slow,
            thesis,
            "The same with the thesis's gains, sampled each 50 ms, one sample of delay",
            "Joint 3 does so alone too, and shakes the others.",
        ),
    ):
        record = attempt(mechanism, gains, "ramps", duration=4.0)
        curves = []
        for j in range(3):
            base = record.position[0, j]
            curves.append(Curve(f"setpoint {j + 1}", record.time, record.setpoint[:, j] - base, "dashed"))
            curves.append(Curve(f"joint {j + 1}", record.time, record.position[:, j] - base))
        yield Figure(key, title, "time [s]", "from the start [rad]", tuple(curves), note=note)
    yield _growth(own)


def _growth(gains) -> Figure:
    """Amplitude of the limit cycle against the delay, together and alone."""
    delays = np.arange(11)
    curves = []
    for label, alone in (("all joints", None), ("joint 1 alone", 1), ("joint 2 alone", 2), ("joint 3 alone", 3)):
        size = []
        for delay in delays.tolist():
            mechanism = _late(delay)
            result = tail(attempt(mechanism, gains, "ramps", alone=alone, duration=10.0), mechanism.period)
            size.append(1e3 * max(result.after) if result.sustained else np.nan)
        curves.append(Curve(label, delays, np.array(size), "line" if alone is None else "dashed"))
    return Figure(
        "7.7.4-delay",
        "Size of the limit cycle with the corrected model's gains",
        "delay [samples of 28/30 ms]",
        "greatest amplitude of a joint [mrad]",
        tuple(curves),
        note="No point where the motion dies out. 40 V bound the cycle.",
        log_y=True,
    )


@experiment("7.7.4", "All three joints at once: the oscillation of plot 7.22", chapter="7.7")
def joints(context: Context) -> Result:
    """The search, its table, and the redrawn plot."""
    plant = Plant.of()
    rows: list[Row] = []
    numbers: dict = {}
    sets = {"thesis's gains": printed_pid(*TUNED_AT), "gains of the corrected model": gains_of(plant, SERVO_PERIOD, 0)}
    found = _search(context, sets, rows, numbers)
    _delays(plant, sets, rows, numbers)
    figures = tuple(_figures(sets))
    quiet = [
        m.name
        for m in MECHANISMS
        if not any(
            found.get(("thesis's gains", m.name, motion)) is None
            or (
                found["thesis's gains", m.name, motion].sustained
                and found["thesis's gains", m.name, motion].worst > 1e-3
            )
            for motion in MOTIONS
        )
    ]
    numbers["quiet_with_the_thesis_gains"] = quiet
    late = found["gains of the corrected model", "delay of 3 samples (2.8 ms)", "ramps"]
    slow = found["thesis's gains", "sampled each 50 ms, one sample of delay", "ramps"]
    fine = found["thesis's gains", "counts and converter", "ramps"]
    jump = 1e3 * max(
        found["thesis's gains", m.name, motion].worst
        for m in MECHANISMS
        if "friction" in m.name and m.effects
        for motion in MOTIONS
    )
    borne = numbers["gains of the corrected model | delay borne alone, together"]
    rows.insert(
        0,
        Row(
            "oscillation while joints 2 and 3 stand still",
            "",
            "sustained",
            str(found["thesis's gains", "saturation at 40 V", "ramps"]),
            "Does not reproduce at the stated rate with the thesis's gains; what does sustain one is below.",
        ),
    )
    return Result(
        "With the thesis's gains at the stated 28/30 ms nothing that was tried sustains the "
        "oscillation of plot 7.22: not saturation, windup, quantisation, limits, friction, nor "
        f"a delay of up to 28 ms (counts and converter leave {1e6 * max(fine.after):.0f} urad, "
        f"less than a count; dry friction holds the arm, but for rare jumps of up to {jump:.1f} "
        "mrad). Delay is what brings it about. With gains "
        f"tuned joint by joint on the corrected model, each joint alone bears {min(borne[:3])} "
        f"samples of delay and all together {borne[3]}: beyond, the coupling drives a limit "
        f"cycle, at three samples of {', '.join(f'{1e3 * a:.1f}' for a in late.after)} mrad and "
        f"{late.period:.3f} s, bounded by the 40 V. With the thesis's gains it takes slow "
        "sampling: each 50 ms with one sample of delay joint 3 swings by "
        f"{slow.after[2]:.3f} rad and joint 2 by {slow.after[1]:.3f} rad with a period of "
        f"{slow.period:.2f} s. That is nearest to the plot as it is described, but joint 3 does "
        "so alone too, so that there the coupling is not the cause.",
        tuple(rows),
        figures,
        numbers,
    )
