# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An impact or a push of short duration."""

from math import pi, sin

import numpy as np

from puma_sim_core.effects.base import PLACE, SIZE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import bounded, candidate, on_joint, sized, stretches
from puma_sim_core.jit import Table, inlined

#: whole widths [s]: an impact is over in hundredths of a second, a push as a hand gives it lasts up to half a second,
#: as the pulses do that a double pendulum was given (docs/rigs.md)
_WIDTHS = (0.02, 0.03, 0.045, 0.065, 0.1, 0.15, 0.22, 0.33, 0.5)
#: greatest torque [N.m] that the law takes: what comes from outside is bounded by nothing of the machine
_GREATEST = 1e4
#: best places that are kept of each width
_PLACES = 3


@inlined
def pulse_part(share: float) -> float:
    """Share of a pulse's momentum that has come after a share of its width, 0 to 1."""
    if share <= 0.0:
        return 0.0
    if share >= 1.0:
        return 1.0
    return share - sin(2.0 * pi * share) / (2.0 * pi)


@inlined
def pulse_torque(p: Table, k: int, time: float, step: float) -> float:
    """Mean torque [N.m] of the pulse from `time` to `time` + `step` [s], positive in +q; with step 0 its value.

    The mean keeps the momentum of the impact to rounding, however long the steps are.
    """
    if p[k] == 0.0:
        return 0.0
    begin = (time - p[k + 1]) / p[k + 2] + 0.5
    if step > 0.0:
        end = (time + step - p[k + 1]) / p[k + 2] + 0.5
        if end <= 0.0 or begin >= 1.0:
            return 0.0
        return 0.5 * p[k] * (pulse_part(end) - pulse_part(begin)) * p[k + 2] / step
    if begin <= 0.0 or begin >= 1.0:
        return 0.0
    return p[k] * sin(pi * begin) ** 2


def impulse(signals: Signals, joint: int, residual: np.ndarray | None = None) -> list[Candidate]:
    """Half a squared sine of a few widths at the places where it fits what is left best.

    residual : (n, J) voltages that nothing explains so far, `signals.residual` where not given.
    """
    residual = signals.residual if residual is None else residual
    if residual is None:
        return []
    scale, found = float(signals.torque_scale[joint]), []
    values = sized("torque", bounded, "impact", "N.m", _GREATEST)
    for width in (width for width in _WIDTHS if not width < 4.0 * signals.step):
        places, tried = _best_places(signals, residual[:, joint], float(signals.lag[joint]), width)
        for middle in places:
            columns, grid = on_joint(joint, -pulse(signals.time, middle, width)), {"time": middle, "width": width}
            found.append(candidate(columns, [0.0], [6.0 * scale], values, grid, tried=tried))
    return found


def pulse(time: np.ndarray, middle: float, width: float) -> np.ndarray:
    """sin(pi (t - t0 + w/2) / w)^2 within the width, 0 outside."""
    phase = (time - middle) / width
    return np.where(np.abs(phase) < 0.5, np.cos(np.pi * phase) ** 2, 0.0)


def _best_places(signals: Signals, residual: np.ndarray, lag: float, width: float) -> tuple[list[float], int]:
    """Times [s] of the best fits of a pulse, at least a width apart, and how many places there were to choose from."""
    half = int(round(0.5 * width / signals.step))
    window = np.arange(-3 * half, 3 * half + 1)
    template = pulse(window * signals.step, 0.0, width)
    # the winding's voltage for a torque runs ahead of it by L/R
    template = template + lag * np.gradient(template, signals.step)
    # level and slope around the pulse are explained by anything slow
    q, _ = np.linalg.qr(np.stack([np.ones(window.size), window, window**2]).T.astype(float))
    template = template - q @ (q.T @ template)
    template /= np.linalg.norm(template)
    best = []
    for part in stretches(signals):
        if part.stop - part.start < window.size:
            continue
        score = np.abs(np.correlate(residual[part], template, mode="valid"))
        times = signals.time[part][3 * half :]
        for _ in range(_PLACES):
            at = int(score.argmax())
            if not score[at] > 0.0:
                break
            best.append((float(score[at]), float(times[at])))
            score[max(at - 2 * half, 0) : at + 2 * half + 1] = 0.0
    best.sort(reverse=True)
    span = float(signals.time[-1] - signals.time[0])
    return [time for _, time in best[:_PLACES]], max(int(span / (0.5 * width)), 1)


EFFECT = Kind(
    name="impulse",
    order=250,
    acts=TORQUE,
    equation="tau = -p sin(pi (t - t0 + w/2) / w)^2 while |t - t0| < w/2",
    sentence="An impact or a push of short duration that no command in the log causes.",
    parameters=(
        Parameter("torque", "N.m", -_GREATEST, _GREATEST, "p, peak, positive in +q", SIZE, (5.0, 300.0)),
        Parameter("time", "s", -1e6, 1e9, "t0, middle of the pulse", PLACE, step="width"),
        Parameter("width", "s", 1e-4, 100.0, "w, whole width", PLACE, (0.02, 0.25), neutral=1.0, logarithmic=True),
    ),
    laws=(Law(Point.PUSH, pulse_torque),),
    repeatable=False,
    most=4,
    screening=Screening(
        impulse,
        "None can show it again: an impact is not repeatable; repeat the motion to see that it is gone.",
        generous=0.03,
        placed=True,
    ),
    drawn_against=("time",),
    example="impulse:joint=2,torque=40,time=1.5,width=0.05",
)
