# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""An impact of short duration."""

from __future__ import annotations

from math import pi, sin
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Parameter, Point, Role
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import bounded, candidate, on_joint, stretches
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: whole widths of an impact [s]
_WIDTHS = (0.02, 0.03, 0.045, 0.065, 0.1, 0.15)

#: best places that are kept of each width
_PLACES = 3


@inlined
def pulse_part(share):
    """Share of a pulse's momentum that has come after a share of its width, 0 to 1."""
    if share <= 0.0:
        return 0.0
    if share >= 1.0:
        return 1.0
    return share - sin(2.0 * pi * share) / (2.0 * pi)


@inlined
def pulse_torque(p, k, time, step):
    """Mean torque [N.m] of the pulse from `time` to `time` + `step` [s], positive in +q.

    The mean keeps the momentum of the impact to rounding, however long the steps are. The value at
    an instant comes with step 0.
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

    residual : (n, J) voltages that nothing explains so far, `signals.residual` where not given;
        without it there are no candidates.
    """
    residual = signals.residual if residual is None else residual
    if residual is None:
        return []
    scale = float(signals.torque_scale[joint])
    found = []
    for width in _WIDTHS:
        if width < 4.0 * signals.step:
            continue
        places, tried = _best_places(signals, residual, joint, width)
        for middle in places:
            column = -pulse(signals.time, middle, width)

            def values(c, middle=middle, width=width):
                return {"torque": bounded(c[0], "impact", "N.m", 40.0 * scale), "time": middle, "width": width}

            found.append(
                candidate(
                    on_joint(joint, column), [0.0], [6.0 * scale], values, {"time": middle, "width": width}, tried=tried
                )
            )
    return found


def pulse(time: np.ndarray, middle: float, width: float) -> np.ndarray:
    """sin(pi (t - t0 + w/2) / w)^2 within the width, 0 outside."""
    phase = (time - middle) / width
    return np.where(np.abs(phase) < 0.5, np.cos(np.pi * phase) ** 2, 0.0)


def _best_places(signals: Signals, residual: np.ndarray, joint: int, width: float):
    """Times [s] of the best fits of a pulse of `width`, at least a width apart, and how many
    places there were to choose from."""
    half = int(round(0.5 * width / signals.step))
    window = np.arange(-3 * half, 3 * half + 1)
    template = pulse(window * signals.step, 0.0, width)
    # the winding's voltage for a torque runs ahead of it by L/R
    template = template + float(signals.lag[joint]) * np.gradient(template, signals.step)
    # level and slope around the pulse are explained by anything slow
    basis = np.stack([np.ones(window.size), window, window**2])
    q, _ = np.linalg.qr(basis.T.astype(float))
    template = template - q @ (q.T @ template)
    template /= np.linalg.norm(template)
    best = []
    for part in stretches(signals):
        if part.stop - part.start < window.size:
            continue
        score = np.abs(np.correlate(residual[part, joint], template, mode="valid"))
        times = signals.time[part][3 * half : 3 * half + score.size]
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
        Parameter("torque", "N.m", -1e4, 1e4, "p, peak, positive in +q", plausible=(5.0, 300.0)),
        Parameter("time", "s", -1e6, 1e9, "t0, middle of the pulse", role=Role.PLACE, step="width"),
        Parameter(
            "width",
            "s",
            1e-4,
            100.0,
            "w, whole width",
            neutral=1.0,
            role=Role.PLACE,
            plausible=(0.02, 0.15),
            logarithmic=True,
        ),
    ),
    laws=(Law(Point.PUSH, pulse_torque),),
    repeatable=False,
    screening=Screening(
        impulse,
        excitation="None can show it again: an impact is not repeatable; repeat the motion to see that it is gone.",
        generous=0.03,
    ),
    drawn_against=("time",),
    example="impulse:joint=2,torque=40,time=1.5,width=0.05",
)
