# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.6: the discrete PID controller, its coefficients, and the ultimate gains."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import PidGains, gains_of_recursive, recursive_coefficients
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis.motions import CASES, gains_text
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Numbers, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.ziegler_nichols import SETTINGS, Loop, settings, ultimate_by_simulation, ultimate_map

words = Words(__name__)
#: sample periods [s] at which the ultimate gains are drawn; the thesis's 28 ms and the printed
#: "50 mS" of its integration step are among them
PERIODS = np.unique(np.append(np.geomspace(SERVO_PERIOD, 0.08, 14), (0.005, 0.028, 0.05)))
DELAYS = (0, 1, 2)
#: the thesis's own PID of joint 1, on which the printed coefficient is shown to be wrong
EXAMPLE = PidGains(90.0, 0.225, 0.05625)
ULTIMATE = ("gain", "period")


@words.experiment("7.6")
def run(context: Context) -> Result:
    """Coefficients of 7.3, table 7.2, Kmax and Tp by two methods and over rates and delays."""
    plant, measured = Plant.of(), []
    h, text = SERVO_PERIOD, gains_text(EXAMPLE)
    # equations 7.5 to 7.7, printed and corrected
    q = recursive_coefficients(EXAMPLE, h)
    printed = -q.q1 - 2.0 * EXAMPLE.gain * h / EXAMPLE.integral_time
    rows = [
        words.row("q1", q.q1, printed=printed, gains=text),
        words.row("sum", q.q0 + q.q1 + q.q2, printed=q.q0 + printed + q.q2),
        words.row("inverse", gains_text(gains_of_recursive(*q, h))),
        words.row("factor"),
    ]
    for c in CASES:
        exact, slow = c.ultimate(plant), c.ultimate(plant, 0.028, 1)
        simulated = ultimate_by_simulation(Loop(plant, c.joint, c.pose))
        for what in ULTIMATE:
            rows.append(words.row("ultimate", getattr(exact, what), case=what, c=c, simulated=simulated, slow=slow))
        measured.append((exact, simulated, slow))
        context.progress(0.5 * len(measured) / len(CASES))
    numbers: Numbers = {
        f"ultimate_{what}{how}": [getattr(found[n], what) for found in measured]
        for n, how in enumerate(("", "_simulated", "_28ms_delay_1"))
        for what in ULTIMATE
    }
    worst = 100.0 * max(abs(getattr(b, what) / getattr(a, what) - 1.0) for a, b, _ in measured for what in ULTIMATE)
    rows.append(words.row("difference", worst))
    for joint, m in enumerate(plant.arm.motors, 1):
        rows.append(words.row("Routh", m.resistance / m.inductance * m.back_emf * m.gear_ratio, joint=joint))
    for method in SETTINGS:
        text = gains_text(settings(measured[0][0], method)).replace("inf s", "none")
        rows.append(words.row("table 7.2", text, method=method))
    found = _scan(plant, context)
    rows += _nearest(*found, numbers)
    return words.result("7.6", rows, _figures(found), numbers, worst=worst)


def _scan(plant: Plant, context: Context) -> np.ndarray:
    """Kmax and Tp, (2, delay, period, case)."""
    found = np.empty((2, len(DELAYS), len(PERIODS), len(CASES)))
    for (d, delay), (h, step), (c, each) in product(*map(enumerate, (DELAYS, PERIODS, CASES))):
        found[:, d, h, c] = ultimate_map(plant, each.joint, each.pose, period=step, delay=delay, limit=1e5)[:2]
        context.progress(0.5 + 0.5 * (d + 1) / len(DELAYS))
    return found


def _nearest(gain: np.ndarray, period: np.ndarray, numbers: Numbers) -> list[Row]:
    """The rate and delay whose five Kmax and Tp are nearest to the thesis's in the mean ratio."""
    printed = np.array([(c.printed.gain, c.printed.period) for c in CASES])
    mean = np.sqrt((np.log(np.stack([gain, period], axis=-1) / printed) ** 2).mean(axis=(2, 3)))
    d, h = np.unravel_index(np.nanargmin(mean), mean.shape)
    at = int(np.argmin(np.abs(PERIODS - 0.05)))
    nearest = {"period": PERIODS[h], "delay": DELAYS[d], "factor": np.exp(mean[d, h])}
    nearest |= {"gains": gain[d, h], "periods": period[d, h]}
    numbers |= {f"nearest_{what}": each for what, each in nearest.items()}
    numbers |= {"gains_50ms_delay_1": gain[1, at], "periods_50ms_delay_1": period[1, at]}
    return [words.row("nearest", n=numbers, ms=PERIODS[h] * 1e3), words.row("50 ms", n=numbers, printed=printed.T)]


def _figures(found: np.ndarray) -> Iterator[Figure]:
    for what, values in zip(ULTIMATE, found):
        curves = [
            Curve(f"{case.name}{late}", 1e3 * PERIODS, values[delay, :, c], style)
            for c, case in enumerate(CASES)
            for delay, late, style in ((0, "", "line"), (1, ", one sample of delay", "dashed"))
        ]
        printed = [getattr(c.printed, what) for c in CASES]
        curves.append(Curve("thesis", [28.0 / 30.0] * len(CASES), printed, "points"))
        yield words.figure("against samples", curves, case=what)
