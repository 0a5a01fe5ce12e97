# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of what acts from outside: a spring, a base that leans, a blow."""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects.columns.common import bounded, candidate, on_joint, positive, stretches, whole_range
from puma_sim_core.effects.screening import Candidate, Illegal, Screening, Signals

#: whole widths of a blow [s], and the best places that are kept of each
_WIDTHS = (0.02, 0.03, 0.045, 0.065, 0.1, 0.15)
_PLACES = 3


def spring(signals: Signals, joint: int) -> list[Candidate]:
    """q less its mean, and 1: stiffness, and torque at the mean."""
    q, scale = signals.position[:, joint], float(signals.torque_scale[joint])
    middle = float(q.mean())
    low, high = whole_range(signals, joint)
    if high <= low:
        return []
    unit = 2.0 * scale / (high - low)

    def values(c):
        stiffness = positive(c[0], "stiffness", "N.m/rad", 60.0 * unit)
        angle = middle - float(c[1]) / max(stiffness, 1e-12)
        if not 1.5 * low - 0.5 * high <= angle <= 1.5 * high - 0.5 * low:
            raise Illegal(f"spring slack at {angle:.3g} rad, far outside the range {low:.3g} to {high:.3g} rad")
        return {"stiffness": stiffness, "angle": angle}

    return [
        candidate(on_joint(joint, q - middle, np.ones_like(q)), [2.0 * unit, 0.0], [3.0 * unit, 1.5 * scale], values)
    ]


def base_tilt(signals: Signals, joint: int | None) -> list[Candidate]:
    """Change of gravity's torques on all joints per radian of lean in x and in y."""
    if signals.gravity_tilt is None:
        return []

    def values(c):
        return {"x": bounded(c[0], "lean towards x", "rad", 0.35), "y": bounded(c[1], "lean towards y", "rad", 0.35)}

    columns = [{j: signals.gravity_tilt[:, j, axis] for j in range(signals.joints)} for axis in (0, 1)]
    return [candidate(columns, [0.0, 0.0], [0.05, 0.05], values)]


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
                return {"torque": bounded(c[0], "blow", "N.m", 40.0 * scale), "time": middle, "width": width}

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


SCREENINGS = {
    "joint_spring": Screening(
        spring,
        look_alikes=(
            ("soft_stop", "the torque is straight over the whole range, without a kink"),
            ("base_tilt", "the torque is a line in the joint's own position, on this joint alone"),
            ("payload", "the torque is a line in the joint's own position, on this joint alone"),
            (
                "voltage_offset",
                "the torque changes with the position; a spring with an offset is "
                "a spring that is slack at another angle",
            ),
            ("encoder_offset", "the torque is a line in the position, also where gravity's slope changes"),
            ("asymmetric_coulomb_friction", "the torque changes with the position, not with the direction of motion"),
            ("presliding_friction", "the torque grows over the whole range, not within a milliradian of each reversal"),
        ),
        excitation="Slow motion over the full range of the joint.",
        plausible=(("stiffness", 0.5, 50.0),),
    ),
    "base_tilt": Screening(
        base_tilt,
        look_alikes=(
            ("joint_spring", "joint 1 feels gravity with a period of a turn, and more with the arm stretched out"),
            ("voltage_offset", "the torque turns with joint 1"),
            ("asymmetric_coulomb_friction", "the torque does not change with the direction of motion"),
            ("encoder_offset", "joint 1 feels gravity too"),
        ),
        excitation="Joint 1 over more than 120 degrees, with the arm stretched out and folded.",
        plausible=(("x", 0.005, 0.15), ("y", 0.005, 0.15)),
    ),
    "impulse": Screening(
        impulse,
        look_alikes=(
            ("backlash", "it comes once; two or more at reversals of the transmitted torque are backlash"),
            ("stribeck_friction", "it comes once, not at each slow motion"),
            ("soft_stop", "it comes at one time, not at one position"),
        ),
        excitation="None can show it again: a blow is not repeatable; repeat the motion to see that it is gone.",
        # a limit that was met once leaves the mark of a blow, whose time, width and torque are free
        contains=("current_limit", "voltage_saturation", "soft_stop"),
        generous=0.03,
        plausible=(("torque", 5.0, 300.0), ("width", 0.02, 0.15)),
    ),
}
