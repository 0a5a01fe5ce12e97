# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Section 7.8: the controller's gains from its own input and output, on records whose gains are
known; and what equations 7.9 and 7.10 can and cannot give."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import log, pi

import numpy as np

from puma_sim_core.dynamics.pid import PidGains, recursive_coefficients
from puma_sim_core.errors import RecordingError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis.controller_records import COUNTS, RECORD, Maker, Motion, motions
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.tuning.controller_log import ControllerLog
from puma_sim_core.tuning.least_squares import RecursiveLeastSquares
from puma_sim_core.tuning.pid_identification import PidEstimate, compare_gains, identify_pid
from puma_sim_core.tuning.transfer_function import (
    METHODS,
    TransferFunction,
    identify_transfer_function,
    implied_gains,
    poles,
)

#: of the motors' voltage [V]
LIMIT = 40.0
#: records of each kind from which scatter is taken, and pairs for the test of equal gains
RECORDS = 20
PAIRS = 6
_FREE, _INSTRUMENTS = METHODS


@dataclass(frozen=True)
class Printed:
    """An equation of the thesis and the gains that it quotes beside it."""

    key: str
    pose: str
    numerator: tuple[float, float, float]
    denominator: tuple[float, float]
    gains: PidGains
    percent: tuple[float, float, float]


EQUATIONS = (
    Printed(
        "7.9",
        "arm extended and horizontal",
        (6739.0, 1430.0, 5743.0),
        (0.96, 0.106),
        PidGains(137.0, 0.315, 0.032),
        (13.0, 15.0, 40.0),
    ),
    Printed(
        "7.10",
        "near the highest point",
        (8618.0, 15106.0, 8913.0),
        (1.13, 0.0972),
        PidGains(176.0, 0.42, 0.04),
        (45.0, 27.0, 50.0),
    ),
)
GAIN_NAMES = (("Kg", "V/rad"), ("Ti", "s"), ("Td", "s"))


def free_gains(found: TransferFunction) -> tuple[float, float, float]:
    """Kg, Ti, Td from a free transfer function as the section has it: a2 ignored, 7.5 to 7.7."""
    return tuple(implied_gains(found.coefficients, found.period))


def readings(equation: Printed, period: float) -> list[tuple[float, tuple, str]]:
    """(distance, gains, words) of each choice of signs in the numerator, the nearest first.

    distance : the greatest of |log(gain / quoted)| over Kg, Ti, Td; only positive gains count.
    """
    quoted = (equation.gains.gain, equation.gains.integral_time, equation.gains.derivative_time)
    found = []
    for s1, s2, as_printed in product((1.0, -1.0), (1.0, -1.0), (False, True)):
        q = (equation.numerator[0], s1 * equation.numerator[1], s2 * equation.numerator[2])
        gains = implied_gains(q, period, as_printed=as_printed)
        if min(gains) > 0.0:
            distance = max(abs(log(g / r)) for g, r in zip(gains, quoted))
            words = f"q1 = {q[1]:+g}, q2 = {q[2]:+g}, 7.6 {'as printed' if as_printed else 'corrected'}"
            found.append((distance, tuple(gains), words))
    return sorted(found)


def equation_rows(equation: Printed, period: float) -> tuple[list[Row], dict]:
    """What an equation gives as it stands."""
    quoted = (equation.gains.gain, equation.gains.integral_time, equation.gains.derivative_time)
    needed = recursive_coefficients(equation.gains, period)
    found = poles(equation.denominator)
    words = ", ".join(f"{z.real:.4g}" if z.imag == 0.0 else f"{z:.4g}" for z in found)
    unstable = abs(found[0]) > 1.0
    a1, a2 = equation.denominator
    signed = min(
        (z for s1, s2 in product((1.0, -1.0), repeat=2) for z in poles((s1 * a1, s2 * a2))), key=lambda z: abs(z - 1.0)
    ).real
    rows = [
        Row(
            f"poles of {equation.key}",
            "",
            f"1 + {a1:g} z^-1 + {a2:g} z^-2",
            words,
            "A PID controller has one pole, at +1 (7.4). Here the voltage alternates from "
            f"sample to sample{', and grows' if unstable else ''}: signs were lost. With any "
            f"signs the nearest pole to +1 is {signed:.4f}.",
        )
    ]
    numbers = {f"{equation.key}_poles": [z.real for z in found], f"{equation.key}_nearest_pole": signed}
    for name, as_printed in (("corrected", False), ("as printed", True)):
        gains = implied_gains(equation.numerator, period, as_printed=as_printed)
        numbers[f"{equation.key}_implied_{name.replace(' ', '_')}"] = list(gains)
        for (symbol, unit), value, told in zip(GAIN_NAMES, gains, quoted):
            if as_printed and symbol != "Ti":
                continue  # 7.6 enters Ti alone
            rows.append(
                Row(
                    f"{symbol} that {equation.key} implies, 7.6 {name}",
                    unit,
                    told,
                    value,
                    "Does not follow: "
                    + ("a controller has no such gain." if value < 0.0 else f"{value / told:.3g} times the quoted."),
                )
            )
    near = readings(equation, period)
    numbers[f"{equation.key}_nearest_reading"] = list(near[0][1]) if near else None
    rows.append(
        Row(
            f"{equation.key}, the signs that come nearest",
            "V/rad, s, s",
            ", ".join(f"{g:g}" for g in quoted),
            ", ".join(f"{g:.3g}" for g in near[0][1]) if near else "none is positive",
            (f"{near[0][2]}. " if near else "") + "No choice of signs gives the quoted values.",
        )
    )
    for name, value, printed in zip(("q0", "q1", "q2"), needed, equation.numerator):
        numbers[f"{equation.key}_{name}_of_quoted"] = value
        rows.append(
            Row(
                f"{name} that the quoted gains at {equation.key} need",
                "V/rad",
                printed,
                value,
                "" if abs(value - printed) < 5e-3 * abs(printed) else f"Printed is {printed / value:.3g} times it.",
            )
        )
    return rows, numbers


def sensitivity_rows(equation: Printed, period: float) -> tuple[list[Row], dict]:
    """How exactly the coefficients must be known for the quoted precision."""
    q0, q1, q2 = recursive_coefficients(equation.gains, period)
    gain = equation.gains.gain
    kg = 0.01 * equation.percent[0] * gain / q0
    ti = 0.01 * equation.percent[1] * (q0 + q1 + q2) / abs(q1)
    rows = [
        Row(
            f"q0 or q2 to know Kg within {equation.percent[0]:g} %, {equation.key}",
            "%",
            None,
            100.0 * kg,
            f"Kg = q0 - q2 is a difference of near-equal numbers: 1 % of q0 is {q0 / gain:.3g} % of Kg.",
        ),
        Row(
            f"q1 to know Ti within {equation.percent[1]:g} %, {equation.key}",
            "%",
            None,
            100.0 * ti,
            f"q0 + q1 + q2 is {q0 + q1 + q2:.3g}; coefficients of four digits, as "
            "printed, are each uncertain by more: Ti cannot come from them.",
        ),
    ]
    return rows, {f"{equation.key}_needed_q0_percent": 100.0 * kg, f"{equation.key}_needed_q1_percent": 100.0 * ti}


def half_range(values: np.ndarray) -> np.ndarray:
    """Half of the range of each column in percent of its mean: what +- may mean in the section."""
    return 50.0 * np.ptp(values, axis=0) / np.abs(values.mean(axis=0))


def estimate_rows(equation: Printed, known, free, instruments, sample: PidEstimate) -> tuple[list[Row], dict]:
    """Estimates over all records of one pose beside the gains they were made with."""
    rows, numbers = [], {}
    told = (equation.gains.gain, equation.gains.integral_time, equation.gains.derivative_time)
    intervals = (sample.gain, sample.integral_time, sample.derivative_time)
    for j, (symbol, unit) in enumerate(GAIN_NAMES):
        true = true_gains(equation.gains)[j]
        rows.append(
            Row(
                f"{symbol}, {equation.pose}, denominator known",
                unit,
                f"{told[j]:g} +-{equation.percent[j]:g} %",
                float(known[:, j].mean()),
                f"Made with {true:.6g}; {RECORDS} records within +-{half_range(known)[j]:.2g} %. One "
                f"record: {intervals[j].low:.6g} to {intervals[j].high:.6g}, certainly. It is the "
                "quoted value since the record was made with it.",
            )
        )
        bias = 100.0 * (free[:, j].mean() / true - 1.0)
        rows.append(
            Row(
                f"{symbol}, {equation.pose}, as in the section",
                unit,
                f"{told[j]:g} +-{equation.percent[j]:g} %",
                float(free[:, j].mean()),
                f"Denominator of order 2 left free, a2 ignored: off by {bias:+.2g} %, +-"
                f"{half_range(free)[j]:.2g} %. With instruments "
                f"{100.0 * (instruments[:, j].mean() / true - 1.0):+.2g} %, "
                f"+-{half_range(instruments)[j]:.2g} %.",
            )
        )
    for name, values in (("known", known), ("free", free), ("instruments", instruments)):
        numbers[f"{equation.key}_{name}_mean"] = values.mean(axis=0)
        numbers[f"{equation.key}_{name}_half_range_percent"] = half_range(values)
    return rows, numbers


def true_gains(gains: PidGains) -> tuple[float, float, float]:
    """Kg, Ti, Td of the servo's law (the sum with the present error) in the form of 7.5 to 7.7."""
    share = 1.0 + SERVO_PERIOD / gains.integral_time
    return gains.gain * share, gains.integral_time * share, gains.derivative_time / share


def estimates(logs: list[ControllerLog]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(records, 3) Kg, Ti, Td: denominator known, free, free with instruments."""
    known = [identify_pid(log, form="velocity", derivative="error", bounds=False) for log in logs]
    return (
        np.array([[k.gain.value, k.integral_time.value, k.derivative_time.value] for k in known]),
        np.array([free_gains(identify_transfer_function(log)) for log in logs]),
        np.array([free_gains(identify_transfer_function(log, method=_INSTRUMENTS)) for log in logs]),
    )


def faults(maker: Maker, places: dict[str, Motion], clean: ControllerLog, rng) -> list[Row]:
    """What a free denominator gives where the record is not what the controller saw."""
    gains = EQUATIONS[0].gains
    coarse = 2.0 * LIMIT / 2.0**8
    cases = (
        ("12-bit voltage, as recorded", clean),
        ("voltage read to 8 bits", _changed(clean, voltage=np.round(clean.voltage / coarse) * coarse)),
        ("50 mV of noise on the voltage", _changed(clean, voltage=clean.voltage + rng.normal(0.0, 0.05, len(clean)))),
        (
            "0.1 mrad of noise on the position",
            _changed(clean, position=clean.position + rng.normal(0.0, 1e-4, len(clean))),
        ),
        ("voltage recorded one sample late", _changed(clean, voltage=np.roll(clean.voltage, 1))),
        ("derivative of the measurement", maker.log(places["7.9"], gains, rng, on_measurement=True)),
        (
            "the quoted gains of 7.10 on a motion that takes the voltage to its limit",
            maker.log(places["fast"], EQUATIONS[1].gains, rng),
        ),
    )
    rows = []
    for name, record in cases:
        found = identify_transfer_function(record)
        a = [c.value for c in found.denominator]
        q = found.coefficients
        g = free_gains(found)
        try:
            known = identify_pid(record, form="velocity", limit=LIMIT, bounds=False)
            beside = (
                f"Denominator known: Kg {known.gain.value:.4g}, "
                f"Ti {known.integral_time.value:.3g}, Td {known.derivative_time.value:.3g}."
            )
        except RecordingError as error:
            beside = f"Denominator known: refused, {error.what}."
        rows.append(
            Row(
                f"a1, a2; q0, q1, q2: {name}",
                "V/rad",
                "0.96, 0.106; 6739, 1430, 5743",
                f"{a[0]:.4f}, {a[1]:.4f}; {q[0]:.0f}, {q[1]:.0f}, {q[2]:.0f}",
                f"Implies Kg {g[0]:.3g}, Ti {g[1]:.3g}, Td {g[2]:.3g}. {beside}",
            )
        )
    return rows


def _changed(record: ControllerLog, **values) -> ControllerLog:
    columns = {name: values.get(name, getattr(record, name)) for name in ("setpoint", "position", "voltage")}
    return ControllerLog(record.period, **columns, where=record.where)


def scheduling(maker: Maker, places: dict[str, Motion], rng) -> tuple[list[Row], dict]:
    """The test of equal gains: with the quoted ones, with equal ones, with nearly equal ones."""
    low, high = (e.gains for e in EQUATIONS)
    # the smallest changes of one gain that are looked for
    changed = {
        "Kg 0.02 % greater": PidGains(1.0002 * low.gain, low.integral_time, low.derivative_time),
        "Kg 1 % greater": PidGains(1.01 * low.gain, low.integral_time, low.derivative_time),
    }
    cases = {"equal gains": low, **changed, "the gains quoted for the two poses": high}
    rows, numbers = [], {}
    first = [identify_pid(maker.log(places["7.9"], low, rng), derivative="error") for _ in range(PAIRS)]
    for name, gains in cases.items():
        found = [
            compare_gains(a, identify_pid(maker.log(places["7.10"], gains, rng), derivative="error")) for a in first
        ]
        certain = sum(bool(f.different) for f in found)
        by_chance = sum(f.p_value < f.level for f in found)
        numbers[f"scheduling_{name}"] = [certain, by_chance, PAIRS]
        rows.append(
            Row(
                f"scheduling found, {name}",
                f"of {PAIRS} pairs",
                None,
                certain,
                f"By rounding bounds; by Wald's test at 1 %: {by_chance}.",
            )
        )
    bars = [tuple(e.gains.gain * (1.0 + sign * 0.01 * e.percent[0]) for sign in (-1.0, 1.0)) for e in EQUATIONS]
    rows.append(
        Row(
            "Kg at the two poses",
            "V/rad",
            "different: gain scheduling",
            f"{bars[0][0]:.0f} to {bars[0][1]:.0f} and {bars[1][0]:.0f} to {bars[1][1]:.0f}",
            "By the section's own +- the intervals overlap, as do those of Ti and Td: its "
            "numbers do not show that the gains differ.",
        )
    )
    return rows, numbers


def running(rows: np.ndarray, values: np.ndarray, along, every: int = 32):
    """Samples and the value of `along(theta)` as the recursion goes on, once it is determined."""
    recursion = RecursiveLeastSquares(rows.shape[1])
    samples, found = [], []
    for first in range(0, len(values), every):
        recursion.update(rows[first : first + every], values[first : first + every])
        if recursion.samples > 4 * every and recursion.determined:
            samples.append(recursion.samples)
            found.append(along(recursion.estimate))
    return np.array(samples), np.array(found)


def figures(maker: Maker, logs: dict[str, list[ControllerLog]], scatter, motion: Motion, rng):
    """Joint profiles, the recursion, the scatter, and the bias against the converter's width."""
    for key, equation in (("7.8", EQUATIONS[0]), ("7.24", EQUATIONS[1])):
        record = logs[equation.key][0]
        time = record.period * np.arange(len(record))
        yield Figure(
            key,
            f"Joint 1 during the repeated 10 mm motion, {equation.pose}",
            "time [s]",
            "joint 1 [mrad]",
            (
                Curve("setpoint", time, 1e3 * (record.setpoint - record.setpoint[0]), "steps"),
                Curve("position", time, 1e3 * (record.position - record.setpoint[0])),
            ),
        )
    record = logs["7.9"][0]
    time = record.period * np.arange(len(record))
    yield Figure(
        "7.8 voltage",
        "Voltage of joint 1's controller in the same record",
        "time [s]",
        "voltage [V]",
        (Curve("voltage, 12 bits", time, record.voltage, "steps"),),
    )
    e, u, n = record.error, record.voltage, len(record)
    total = np.cumsum(e)
    known = running(np.column_stack([e[1:], total[:-1], np.diff(e), np.ones(n - 1)]), u[1:], lambda theta: theta[0])
    free = running(
        np.column_stack([-u[1:-1], -u[:-2], e[2:], e[1:-1], e[:-2]]), u[2:], lambda theta: theta[2] - theta[4]
    )
    true = true_gains(EQUATIONS[0].gains)[0]
    yield Figure(
        "7.8 recursion",
        "Kg as the recursion goes on",
        "samples",
        "Kg [V/rad]",
        (
            Curve("denominator known", *known),
            Curve("denominator free", *free),
            Curve("true", [0.0, RECORD], [true, true], "dashed"),
        ),
    )
    yield Figure(
        "7.8 scatter",
        f"{RECORDS} records, {EQUATIONS[0].pose}",
        "Kg [V/rad]",
        "Ti [s]",
        tuple(
            Curve(name, values[:, 0], values[:, 1], "points")
            for name, values in zip(("denominator known", "free", "free, instruments"), scatter)
        ),
        "All made with the same gains.",
    )
    widths = np.arange(7, 17)
    by_width = np.stack([estimates([maker.log(motion, EQUATIONS[0].gains, rng, bits=int(bits))]) for bits in widths])[
        :, :, 0, 0
    ]
    yield Figure(
        "7.8 bits",
        "Error of Kg against the width of the converter",
        "bits",
        "error of Kg [%]",
        tuple(
            Curve(name, widths, 100.0 * np.abs(by_width[:, j] / true - 1.0))
            for j, name in enumerate(("denominator known", "free", "free, instruments"))
        ),
        "The section's converter has 12 bits.",
        log_y=True,
    )


@experiment("7.8", "Identification of the controller's parameters", chapter="7.8")
def run(context: Context) -> Result:
    """Equations 7.9 and 7.10, and recursive least squares on records with known gains."""
    maker = Maker(Plant.of("bejczy", (), "physical"))
    places = motions(maker.plant.arm)
    rows, numbers, logs, scatter = [], {}, {}, {}
    for share, equation in enumerate(EQUATIONS):
        more, values = equation_rows(equation, SERVO_PERIOD)
        rows += more
        numbers |= values
        rng = context.rng(f"7.8 records {equation.key}")
        logs[equation.key] = [maker.log(places[equation.key], equation.gains, rng) for _ in range(RECORDS)]
        scatter[equation.key] = estimates(logs[equation.key])
        sample = identify_pid(logs[equation.key][0], form="velocity")
        more, values = estimate_rows(equation, *scatter[equation.key], sample)
        rows += more
        numbers |= values
        more, values = sensitivity_rows(equation, SERVO_PERIOD)
        rows += more
        numbers |= values
        context.progress(0.3 * (share + 1))
    rows += faults(maker, places, logs["7.9"][0], context.rng("7.8 faults"))
    rows.append(along_x(maker, places["along x"], context.rng("7.8 along x")))
    context.progress(0.7)
    more, values = scheduling(maker, places, context.rng("7.8 scheduling"))
    rows += more
    numbers |= values
    context.progress(0.9)
    drawn = tuple(figures(maker, logs, scatter["7.9"], places["7.9"], context.rng("7.8 bits")))
    context.progress(1.0)
    return Result(
        "The quoted PID values do not follow from equations 7.9 and 7.10, with any signs; on "
        "records whose gains are known, least squares finds them again. "
        "Kg is the difference of coefficients some forty times larger, and Ti comes from a sum "
        "four orders smaller than they are, so that the small bias which 12-bit voltages bring "
        "into a free denominator is "
        f"{_off(numbers, 'free', 0):.2g} % of Kg and {_off(numbers, 'free', 1):.2g} % of Ti; with "
        "instruments, or better with the denominator 1 - z^-1 known, it is gone, and one record of "
        "4096 samples gives all three gains within 0.2 %. Rounding to 12 bits does not explain the "
        "section's +-13 to 50 %, nor a z^-2 term of 0.1; noise on the voltage, positions other "
        "than those that the controller read and a limit that is reached do spoil a free "
        "denominator by as much, though none of those tried gives 7.9 or 7.10. The intervals that "
        "the section quotes for the two poses overlap, so that its numbers do not show gain "
        "scheduling; the test here finds a change of Kg of 0.02 % between two records.",
        rows,
        drawn,
        numbers,
    )


def _off(numbers: dict, kind: str, gain: int) -> float:
    """Mean error in percent, as a magnitude, over the records of 7.9."""
    true = true_gains(EQUATIONS[0].gains)[gain]
    return abs(100.0 * (numbers[f"7.9_{kind}_mean"][gain] / true - 1.0))


def along_x(maker: Maker, motion: Motion, rng) -> Row:
    """The same motion with the arm along x."""
    record = maker.log(motion, EQUATIONS[0].gains, rng)
    counts = np.ptp(record.position) * COUNTS * maker.plant.arm.motors[0].gear_ratio / (2.0 * pi)
    try:
        found = identify_pid(record, form="velocity", bounds=False)
        words = (
            f"Kg {found.gain.low:.4g} to {found.gain.high:.4g}, Ti "
            f"{found.integral_time.low:.3g} to {found.integral_time.high:.3g}, Td "
            f"{found.derivative_time.low:.3g} to {found.derivative_time.high:.3g}"
        )
    except RecordingError as error:
        words = error.what
    return Row(
        "the same motion with the arm along x",
        "V/rad, s, s",
        None,
        words,
        f"The setpoint of joint 1 then moves by {1e3 * np.ptp(record.setpoint):.2g} mrad; "
        f"the coupling of the joints alone moves it, by {counts:.0f} counts. The section "
        "does not say where the arm points; here it points along y, across the motion.",
    )
