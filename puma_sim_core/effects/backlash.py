# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Backlash between the teeth of a gear."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import ROTOR_INERTIA, TRANSMISSION, Kind, Needs, Parameter, Role, Train
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, is_arm, moves, stretches, visible
from puma_sim_core.effects.shared.drive_train import MOTOR_SHARE, beginning, link_side, on_links
from puma_sim_core.jit import compiled

if TYPE_CHECKING:
    pass

#: gaps [rad]
_GAPS = np.geomspace(1.5e-4, 4e-3, 13)

#: stiffness and damping of teeth in contact on the arm, in the screening and as the default of a simulated effect; the
#: priors of the parameters, which a fit goes by, are those of machines
_CONTACT_STIFFNESS, _CONTACT_DAMPING = 2e5, 100.0

#: least share of critical damping of the contact. The rotor recoils from an impact, and back-EMF
#: damps it, faster than the filtered motion shows: with the damping of the teeth alone the
#: simulated link would bounce where the real one does not.
_LEAST_DAMPING = 0.8


def backlash(signals: Signals, joint: int) -> list[Candidate]:
    """Torque through teeth with backlash less that through a rigid joint, with coefficient 1, for a
    grid of the gap."""
    if not moves(signals, joint):
        return []
    inertia, torque = link_side(signals, joint)
    stiffness, damping, gaps = _CONTACT_STIFFNESS, _CONTACT_DAMPING, _GAPS
    if not is_arm(signals):
        mean = float(inertia.mean())
        stiffness = mean * (2.0 * np.pi * 60.0) ** 2
        damping = 0.3 * float(np.sqrt(stiffness * mean))
        gaps = gaps * min(1.0, float(np.ptp(signals.position[:, joint])))
    contact = {"stiffness": float(stiffness), "damping": float(damping)}
    found = []
    for gap in gaps:

        def values(c, gap=float(gap)):
            return {"gap": gap, **contact}

        passed = tooth_torque(signals, torque, inertia, float(gap), stiffness, damping)
        column = on_links(signals, joint, passed - torque, inertia)
        if visible((column,)):
            found.append(candidate([column], [1.0], [0.15], values, {"gap": float(gap)}, VOLTAGE_COLUMN, fixed=True))
    return found


def tooth_torque(signals: Signals, torque, inertia, gap: float, stiffness: float, damping: float):
    """Torque (n,) [N.m] through teeth with a backlash of `gap` under the measured motion of the rotor,
    averaged over a sample: an impact is shorter than one.

    The damping is at least 0.8 of the critical one of the link: filtered, the rotor's motion has
    lost what keeps the real link from bouncing.
    """
    damping = max(damping, float(2.0 * _LEAST_DAMPING * np.sqrt(stiffness * inertia.mean())))
    fastest = float(np.sqrt(stiffness / inertia.min()))
    parts = max(int(ceil(signals.step * fastest / 0.12)), 1)
    out = np.empty_like(torque)
    for part in stretches(signals):
        out[part] = _knock(
            np.ascontiguousarray(torque[part]),
            np.ascontiguousarray(inertia[part]),
            signals.step / parts,
            parts,
            0.5 * gap,
            stiffness,
            damping,
            beginning(signals, torque[part]),
        )
    return out


@compiled
def _knock(torque, inertia, step, parts, half, stiffness, damping, begins):
    """Torque (n,) of the teeth, each value the mean over the two half intervals about it."""
    out = torque.copy()
    twist = begins / stiffness + (half if begins > 0.0 else -half)
    rate = 0.0
    before = begins
    for i in range(torque.size - 1):
        total = 0.0
        for n in range(parts):
            passed = 0.0
            if twist > half:
                passed = max(stiffness * (twist - half) + damping * rate, 0.0)
            elif twist < -half:
                passed = min(stiffness * (twist + half) + damping * rate, 0.0)
            total += passed
            asked = torque[i] + (torque[i + 1] - torque[i]) * ((n + 0.5) / parts)
            rate += step * (asked - passed) / inertia[i]
            twist += step * rate
        mean = total / parts
        out[i] = 0.5 * (before + mean)
        before = mean
    out[torque.size - 1] = before
    return out


def known_voltage(
    signals: Signals, joint: int, values: Mapping[str, float], torque: np.ndarray
) -> dict[int, np.ndarray]:
    """Voltage [V] that the backlash makes along a measured motion."""
    inertia, rigid = link_side(signals, joint)
    passed = tooth_torque(signals, rigid, inertia, values["gap"], values["stiffness"], values["damping"])
    return on_links(signals, joint, passed - rigid, inertia)


def train(values: Mapping[str, float]) -> Train:
    """A spring with backlash between rotor and link."""
    return Train((values["stiffness"], values["damping"]), values["gap"], values["motor_share"])


EFFECT = Kind(
    name="backlash",
    order=190,
    acts=TRANSMISSION,
    equation="d = qm - ql; tau = max(K (d - g/2) + B dd, 0) for d > g/2, "
    "min(K (d + g/2) + B dd, 0) for d < -g/2, else 0",
    sentence="Backlash between the teeth: the link is free while they change flanks, and a short impact ends it.",
    parameters=(
        Parameter(
            "gap",
            "rad",
            0.0,
            0.2,
            "g, the whole backlash at the joint",
            plausible=(5e-5, 5e-3),
            softened_by="stiffness",
        ),
        Parameter(
            "stiffness",
            "N.m/rad",
            100.0,
            1e7,
            "K of the teeth in contact",
            default=2e5,
            role=Role.RATE,
            prior=(5e5, 2.5),
            logarithmic=True,
        ),
        Parameter("damping", "N.m.s/rad", 0.0, 1000.0, "B of the teeth in contact", default=100.0, prior=(150.0, 2.5)),
        MOTOR_SHARE,
    ),
    train=train,
    vanishes=lambda values: values["gap"] == 0.0,
    needs=Needs(ROTOR_INERTIA, "a rotor that can move against its link"),
    known_voltage=known_voltage,
    screening=Screening(
        backlash,
        excitation="Changes of sign of the torque at the link: bang-bang on joint 1, upright or "
        "hanging links on joints 2 and 3.",
        unseen=(("gap", 2e-4), ("stiffness", 5e5), ("damping", 150.0)),
        fast=True,
    ),
    drawn_against=("link_torque", "torque"),
    example="backlash:joint=2,gap=0.001",
)
