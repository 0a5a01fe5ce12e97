# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.8: the controller's gains from its own input and output, on records whose gains are
known; and what equations 7.9 and 7.10 can and cannot give."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import atan2, hypot, log, pi
from typing import Any

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.inverse_kinematics import wrist_angles
from puma_sim_core.arm.kinematics import wrist_position
from puma_sim_core.control.setpoints import smooth_share
from puma_sim_core.errors import RecordingError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import PidGains, recursive_coefficients
from puma_sim_core.servo.servo import DEFAULT_GAINS, ServoConfig
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.thesis.motions import LIMIT, kg_ti_td
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Numbers, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.controller_log import ControllerLog
from puma_sim_core.tuning.least_squares import RecursiveLeastSquares
from puma_sim_core.tuning.pid_identification import PidEstimate, compare_gains, identify_pid
from puma_sim_core.tuning.transfer_function import METHODS, identify_transfer_function, implied_gains, poles

words = Words(__name__)
#: "about 4 kbytes": the longest record of section 7.1.2, taken as 4096 samples of each channel
RECORD = 4096
#: of the encoder, a motor turn
COUNTS = 1000
#: the end effector's repeated motion [m]
STROKE = 0.010
#: records of each kind from which scatter is taken, and pairs for the test of equal gains
RECORDS = 20
PAIRS = 6
GAIN_NAMES = (("Kg", "V/rad"), ("Ti", "s"), ("Td", "s"))
SIGNS = tuple(product((1.0, -1.0), (1.0, -1.0)))
Triple = tuple[float, float, float]


# ----------------------------------------------------------------------------------- records


@dataclass(frozen=True)
class Motion:
    """The wrist goes to and fro: joint angles at one end [rad], displacement and duration of a stroke [m, s]."""

    start: Triple
    displacement: Triple = (STROKE, 0.0, 0.0)
    stroke: tuple[float, float] = (0.25, 0.42)


def motions(arm: ArmParameters) -> dict[str, Motion]:
    """The two motions of the section.

    The arm that is stretched horizontally points along y, half a millimetre short of its reach:
    along x, a motion in x would not turn joint 1 at all. The highest point itself is above the
    shoulder, where any motion would turn joint 1 by much; the wrist moves 28 mm below it, slowly
    enough that the derivative of a step of the setpoint stays below 40 V, and "fast", where it
    does not.
    """
    stretched = atan2(arm.d4, arm.a3)
    reach = hypot(arm.a2 + hypot(arm.a3, arm.d4) - 0.0005, arm.d3)
    end = (-0.5 * STROKE, (reach**2 - 0.25 * STROKE**2) ** 0.5, 0.0)
    horizontal = wrist_angles(end, arm, (0.5 * pi, -0.03, stretched + 0.06))
    high = (0.5 * pi, -0.5 * pi + 0.2, stretched + 0.1)
    return {
        "7.9": Motion(tuple(horizontal)),
        "7.10": Motion(high, stroke=(0.7, 1.0)),
        "fast": Motion(high),
        "along x": Motion((0.0, -0.03, stretched + 0.06), (-STROKE, 0.0, 0.0)),
    }


class Maker:
    """Makes records of joint 1's controller, of known gains, as section 7.1.2 took them."""

    def __init__(self) -> None:
        self.plant = Plant.of()
        self.motions = motions(self.plant.arm)

    def log(self, place: str, gains: PidGains, rng: np.random.Generator, **servo: Any) -> ControllerLog:
        """RECORD samples of a motion: setpoints each 28 ms, encoder counts, voltages of 12 bits.

        The duration of a stroke and the place between two counts where joint 1 starts are random.
        servo : other options of `ServoConfig`.
        """
        arm, motion = self.plant.arm, self.motions[place]
        stroke, between = rng.uniform(*motion.stroke), rng.uniform(-1e-4, 1e-4)
        setpoint = repeated(arm, motion, stroke, RECORD // 30 + 1)
        simulator = Simulator(self.plant)
        simulator.reset(setpoint[0] + (between, 0.0, 0.0))
        # the other joints' servo is ours; its derivative is of the measurement, without kicks
        usual = {"converter_bits": 12, "encoder_counts": COUNTS, "derivative_on_measurement": False}
        run = simulator.run_servo(setpoint, ServoConfig((gains, *DEFAULT_GAINS[1:]), **{**usual, **servo}))
        columns = (values[:RECORD, 0] for values in (run.setpoint, run.position, run.voltage))
        step = 2.0 * pi / (COUNTS * arm.motors[0].gear_ratio)
        return ControllerLog(SERVO_PERIOD, *columns, "record").with_counts(abs(step))


def repeated(arm: ArmParameters, motion: Motion, stroke: float, rows: int, period: float = 0.028) -> np.ndarray:
    """(rows, 3) setpoints [rad] of a straight stroke of `stroke` seconds, to and fro."""
    origin, displacement = wrist_position(np.array(motion.start), arm), np.array(motion.displacement)
    whole, part = np.divmod(np.arange(rows) * period / stroke, 1.0)
    part = smooth_share(part)
    setpoint = [np.array(motion.start)]
    for share in np.where(whole % 2.0 == 0.0, part, 1.0 - part):
        setpoint.append(wrist_angles(origin + share * displacement, arm, setpoint[-1]))
    return np.array(setpoint[1:])


# -------------------------------------------------------------------------------- equations


@dataclass(frozen=True)
class Printed:
    """An equation of the thesis and the gains that it quotes beside it."""

    key: str
    pose: str
    numerator: Triple
    denominator: tuple[float, float]
    gains: PidGains
    percent: Triple


#: equations 7.9 and 7.10
EQUATIONS = [Printed(**{**entry, "gains": PidGains(*entry["gains"])}) for entry in words.table("equations")]


def readings(equation: Printed) -> list[tuple[float, Triple, str]]:
    """(greatest |log(gain / quoted)|, gains, words) of each choice of signs with positive gains, the nearest first."""
    found = []
    q0, q1, q2 = equation.numerator
    for (s1, s2), as_printed in product(SIGNS, (False, True)):
        gains = tuple(implied_gains((q0, s1 * q1, s2 * q2), SERVO_PERIOD, as_printed=as_printed))
        if min(gains) > 0.0:
            distance = max(abs(log(g / r)) for g, r in zip(gains, kg_ti_td(equation.gains)))
            found.append((distance, gains, words.text("reading", case=as_printed, q1=s1 * q1, q2=s2 * q2)))
    return sorted(found)


def equation_rows(e: Printed, numbers: Numbers) -> list[Row]:
    """What an equation gives as it stands."""
    quoted, (a1, a2), found = kg_ti_td(e.gains), e.denominator, poles(e.denominator)
    nearest = min((z for s1, s2 in SIGNS for z in poles((s1 * a1, s2 * a2))), key=lambda z: abs(z - 1.0)).real
    text = ", ".join(f"{z.real:.4g}" if z.imag == 0.0 else f"{z:.4g}" for z in found)
    rows = [words.row("poles", text, case=abs(found[0]) > 1.0, e=e, nearest=nearest)]
    numbers |= {f"{e.key}_poles": [z.real for z in found], f"{e.key}_nearest_pole": nearest}
    for name, as_printed in (("corrected", False), ("as printed", True)):
        gains = implied_gains(e.numerator, SERVO_PERIOD, as_printed=as_printed)
        numbers[f"{e.key}_implied_{name.replace(' ', '_')}"] = gains
        for (symbol, unit), value, told in zip(GAIN_NAMES, gains, quoted):
            if symbol == "Ti" or not as_printed:  # 7.6 enters Ti alone
                about = {"symbol": symbol, "unit": unit, "printed": told, "name": name, "ratio": value / told}
                rows.append(words.row("implied", value, case=value < 0.0, e=e, **about))
    near = readings(e)
    numbers[f"{e.key}_nearest_reading"] = near[0][1] if near else None
    rows.append(words.row("signs", case=bool(near), e=e, quoted=quoted, near=near))
    for name, value, printed in zip(("q0", "q1", "q2"), recursive_coefficients(e.gains, SERVO_PERIOD), e.numerator):
        numbers[f"{e.key}_{name}_of_quoted"] = value
        equal = abs(value - printed) < 5e-3 * abs(printed)
        rows.append(words.row("needed", value, case=equal, e=e, name=name, printed=printed, ratio=printed / value))
    return rows


def sensitivity_rows(e: Printed, numbers: Numbers) -> list[Row]:
    """How exactly the coefficients must be known for the quoted precision."""
    q0, q1, q2 = recursive_coefficients(e.gains, SERVO_PERIOD)
    total, gain = q0 + q1 + q2, e.gains.gain
    kg = numbers[f"{e.key}_needed_q0_percent"] = 100.0 * (0.01 * e.percent[0] * gain / q0)
    ti = numbers[f"{e.key}_needed_q1_percent"] = 100.0 * (0.01 * e.percent[1] * total / abs(q1))
    return [words.row("needed for Kg", kg, e=e, ratio=q0 / gain), words.row("needed for Ti", ti, e=e, total=total)]


def estimate_rows(e: Printed, found: dict[str, np.ndarray], sample: PidEstimate, numbers: Numbers) -> list[Row]:
    """Estimates over all records of one pose beside the gains they were made with."""
    rows = []
    for name, values in found.items():
        numbers[f"{e.key}_{name}_mean"] = values.mean(axis=0)
        # what +- may mean in the section
        numbers[f"{e.key}_{name}_half_range_percent"] = 50.0 * np.ptp(values, axis=0) / np.abs(values.mean(axis=0))
    of_gains = zip(GAIN_NAMES, kg_ti_td(e.gains), true_gains(e.gains), kg_ti_td(sample), e.percent)
    for j, ((symbol, unit), told, true, one, percent) in enumerate(of_gains):
        about = {"e": e, "symbol": symbol, "unit": unit, "told": told, "percent": percent}
        mean = {name: values[:, j].mean() for name, values in found.items()}
        half = {name: numbers[f"{e.key}_{name}_half_range_percent"][j] for name in found}
        off = {name: 100.0 * (value / true - 1.0) for name, value in mean.items()}
        rows += [
            words.row("known", mean["known"], true=true, one=one, half=half, records=RECORDS, **about),
            words.row("free", mean["free"], off=off, half=half, **about),
        ]
    return rows


def true_gains(gains: PidGains) -> Triple:
    """Kg, Ti, Td of the servo's law (the sum with the present error) in the form of 7.5 to 7.7."""
    share = 1.0 + SERVO_PERIOD / gains.integral_time
    return gains.gain * share, gains.integral_time * share, gains.derivative_time / share


def estimates(logs: list[ControllerLog]) -> dict[str, np.ndarray]:
    """(records, 3) Kg, Ti, Td: denominator known; free as the section has it (a2 ignored, 7.5 to
    7.7); free with instruments."""
    known = [identify_pid(log, form="velocity", derivative="error", bounds=False) for log in logs]
    found = {"known": np.array([[value.value for value in kg_ti_td(each)] for each in known])}
    for name, method in zip(("free", "instruments"), METHODS):
        free = [identify_transfer_function(log, method=method).coefficients for log in logs]
        found[name] = np.array([implied_gains(q, SERVO_PERIOD) for q in free])
    return found


def faults(maker: Maker, clean: ControllerLog, rng: np.random.Generator) -> Iterator[Row]:
    """What a free denominator gives where the record is not what the controller saw."""
    coarse = 2.0 * LIMIT / 2.0**8
    low, high = (e.gains for e in EQUATIONS)
    cases = {
        "12 bits": clean,
        "8 bits": replace(clean, voltage=np.round(clean.voltage / coarse) * coarse),
        "noise": replace(clean, voltage=clean.voltage + rng.normal(0.0, 0.05, len(clean))),
        "position": replace(clean, position=clean.position + rng.normal(0.0, 1e-4, len(clean))),
        "late": replace(clean, voltage=np.roll(clean.voltage, 1)),
        "measurement": maker.log("7.9", low, rng, derivative_on_measurement=True),
        "limit": maker.log("fast", high, rng),
    }
    for name, record in cases.items():
        found = identify_transfer_function(record)
        a, q = [c.value for c in found.denominator], found.coefficients
        try:
            known = identify_pid(record, form="velocity", limit=LIMIT, bounds=False)
            beside = words.text("beside", known=known)
        except RecordingError as error:
            beside = words.text("refused", error=error)
        yield words.row("fault", case=name, a=a, q=q, implied=implied_gains(q, SERVO_PERIOD), beside=beside)


def scheduling(maker: Maker, rng: np.random.Generator, numbers: Numbers) -> Iterator[Row]:
    """The test of equal gains: with the quoted ones, with equal ones, with nearly equal ones."""
    low, high = (e.gains for e in EQUATIONS)
    # the smallest changes of one gain that are looked for
    cases = {
        "equal gains": low,
        "Kg 0.02 % greater": replace(low, gain=1.0002 * low.gain),
        "Kg 1 % greater": replace(low, gain=1.01 * low.gain),
        "the gains quoted for the two poses": high,
    }

    def identified(place: str, gains: PidGains) -> PidEstimate:
        return identify_pid(maker.log(place, gains, rng), derivative="error")

    first = [identified("7.9", low) for _ in range(PAIRS)]
    for name, gains in cases.items():
        found = [compare_gains(a, identified("7.10", gains)) for a in first]
        certain = sum(bool(f.different) for f in found)
        by_chance = sum(f.p_value < f.level for f in found)
        numbers[f"scheduling_{name}"] = [certain, by_chance, PAIRS]
        yield words.row("scheduling", certain, name=name, pairs=PAIRS, by_chance=by_chance)
    bars = [[e.gains.gain * (1.0 + sign * 0.01 * e.percent[0]) for sign in (-1.0, 1.0)] for e in EQUATIONS]
    yield words.row("two poses", bars=bars)


def along_x(maker: Maker, rng: np.random.Generator) -> Row:
    """The same motion with the arm along x."""
    record = maker.log("along x", EQUATIONS[0].gains, rng)
    counts = np.ptp(record.position) * COUNTS * maker.plant.arm.motors[0].gear_ratio / (2.0 * pi)
    try:
        text = words.text("intervals", found=identify_pid(record, form="velocity", bounds=False))
    except RecordingError as error:
        text = error.what
    return words.row("along x", text, moved=1e3 * np.ptp(record.setpoint), counts=counts)


def running(
    rows: np.ndarray, values: np.ndarray, along: Callable[[np.ndarray], float], every: int = 32
) -> tuple[list[int], list[float]]:
    """Samples and the value of `along(theta)` as the recursion goes on, once it is determined."""
    recursion = RecursiveLeastSquares(rows.shape[1])
    samples, found = [], []
    for first in range(0, len(values), every):
        recursion.update(rows[first : first + every], values[first : first + every])
        if recursion.samples > 4 * every and recursion.determined:
            samples.append(recursion.samples)
            found.append(along(recursion.estimate))
    return samples, found


def figures(
    maker: Maker, logs: dict[str, list[ControllerLog]], scatter: dict[str, np.ndarray], rng: np.random.Generator
) -> Iterator[Figure]:
    """Joint profiles, the recursion, the scatter, and the bias against the converter's width."""
    for key, e in zip(("7.8", "7.24"), EQUATIONS):
        record = logs[e.key][0]
        time = record.period * np.arange(len(record))
        setpoint, position = (1e3 * (values - record.setpoint[0]) for values in (record.setpoint, record.position))
        yield words.figure(key, [Curve("setpoint", time, setpoint, "steps"), Curve("position", time, position)])
    record = logs["7.9"][0]
    e, u, n = record.error, record.voltage, len(record)
    yield words.figure("7.8 voltage", [Curve("voltage, 12 bits", record.period * np.arange(n), u, "steps")])
    total = np.cumsum(e)
    known = np.column_stack([e[1:], total[:-1], np.diff(e), np.ones(n - 1)])
    free = np.column_stack([-u[1:-1], -u[:-2], e[2:], e[1:-1], e[:-2]])
    true = true_gains(EQUATIONS[0].gains)[0]
    curves = [
        Curve("denominator known", *running(known, u[1:], lambda theta: theta[0])),
        Curve("denominator free", *running(free, u[2:], lambda theta: theta[2] - theta[4])),
        Curve("true", [0.0, RECORD], [true, true], "dashed"),
    ]
    yield words.figure("7.8 recursion", curves)
    points = [Curve(name, values[:, 0], values[:, 1], "points") for name, values in scatter.items()]
    yield words.figure("7.8 scatter", points, records=RECORDS, pose=EQUATIONS[0].pose)
    widths = np.arange(7, 17)
    found = [estimates([maker.log("7.9", EQUATIONS[0].gains, rng, converter_bits=bits)]) for bits in widths.tolist()]
    errors = {name: np.array([each[name][0, 0] for each in found]) / true - 1.0 for name in scatter}
    yield words.figure("7.8 bits", [Curve(name, widths, 100.0 * np.abs(error)) for name, error in errors.items()])


@words.experiment("7.8")
def run(context: Context) -> Result:
    """Equations 7.9 and 7.10, and recursive least squares on records with known gains."""
    maker, rows, numbers, logs, scatter = Maker(), list[Row](), Numbers(), {}, {}
    for share, e in enumerate(EQUATIONS):
        rows += equation_rows(e, numbers)
        rng = context.rng(f"7.8 records {e.key}")
        logs[e.key] = [maker.log(e.key, e.gains, rng) for _ in range(RECORDS)]
        scatter[e.key] = estimates(logs[e.key])
        rows += estimate_rows(e, scatter[e.key], identify_pid(logs[e.key][0], form="velocity"), numbers)
        rows += sensitivity_rows(e, numbers)
        context.progress(0.3 * (share + 1))
    rows += faults(maker, logs["7.9"][0], context.rng("7.8 faults"))
    rows.append(along_x(maker, context.rng("7.8 along x")))
    context.progress(0.7)
    rows += scheduling(maker, context.rng("7.8 scheduling"), numbers)
    context.progress(0.9)
    drawn = list(figures(maker, logs, scatter["7.9"], context.rng("7.8 bits")))
    context.progress(1.0)
    # mean error in percent, as a magnitude, over the records of 7.9
    off = np.abs(100.0 * (numbers["7.9_free_mean"] / np.array(true_gains(EQUATIONS[0].gains)) - 1.0))
    return words.result("7.8", rows, drawn, numbers, off=off)
