# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""An elastic drive: rotor and link are two masses with a spring between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import ROTOR_INERTIA, TRANSMISSION, Kind, Needs, Parameter, Role, Train
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, is_arm, moves, stretches
from puma_sim_core.effects.shared.drive_train import MOTOR_SHARE, beginning, link_side, on_links
from puma_sim_core.jit import compiled

if TYPE_CHECKING:
    pass

#: frequencies [Hz] of the link against a locked rotor, with the shares of critical damping. Real
#: drives are damped less, but then noise of the motion rings in the simulated link, and its phase
#: is lost unless the frequency is known to a percent.
_RESONANCES = ((0.05, np.geomspace(3.0, 45.0, 28)), (0.15, np.geomspace(3.0, 45.0, 16)))

#: stiffnesses of the arm's drives [N.m/rad], beyond the library's on both sides
_STIFFNESSES = (2e3, 1.2e5)


def elasticity(signals: Signals, joint: int) -> list[Candidate]:
    """Torque through an elastic shaft less that through a rigid one, with coefficient 1, for a
    grid of the link's frequency and of the damping."""
    if not moves(signals, joint):
        return []
    inertia, torque = link_side(signals, joint)
    mean = float(inertia.mean())
    found = []
    for damping_ratio, frequencies in _RESONANCES:
        for frequency in frequencies:
            stiffness = float(mean * (2.0 * np.pi * frequency) ** 2)
            if is_arm(signals) and not _STIFFNESSES[0] <= stiffness <= _STIFFNESSES[1]:
                continue
            damping = float(2.0 * damping_ratio * np.sqrt(stiffness * mean))

            def values(c, stiffness=stiffness, damping=damping):
                return {"stiffness": stiffness, "damping": damping}

            passed = shaft_torque(signals, torque, inertia, stiffness, damping)
            found.append(
                candidate(
                    [on_links(signals, joint, passed - torque, inertia)],
                    [1.0],
                    [0.12],
                    values,
                    {"stiffness": stiffness, "damping": damping},
                    VOLTAGE_COLUMN,
                    fixed=True,
                )
            )
    return found


def shaft_torque(signals: Signals, torque, inertia, stiffness: float, damping: float):
    """Torque (n,) [N.m] through a shaft K, B under the measured motion of its rotor.

    The twist d obeys M d'' + B d' + K d = torque, the one of a rigid shaft: solved exactly
    between samples for a torque that changes linearly and an inertia that stays.
    """
    step = signals.step
    decay = damping / (2.0 * inertia)
    turn = np.sqrt(np.maximum(stiffness / inertia - decay**2, 1e-12))
    shrunk = np.exp(-decay * step)
    s, c = shrunk * np.sin(turn * step) / turn, shrunk * np.cos(turn * step)
    flow = np.stack([c + decay * s, s, -(stiffness / inertia) * s, c - decay * s], axis=1)
    out = np.empty_like(torque)
    for part in stretches(signals):
        static = np.ascontiguousarray(torque[part]) / stiffness
        twist, rate = _swing(
            np.ascontiguousarray(flow[part]), static, step, damping / stiffness, beginning(signals, static)
        )
        out[part] = stiffness * twist + damping * rate
    return out


@compiled
def _swing(flow, static, step, lag, begins):
    """Twist and its rate (n,), from rest at a twist on; flow (n, 4) steps the free motion."""
    twist, rate = static.copy(), static.copy()
    d = begins
    v = 0.0
    twist[0] = d
    rate[0] = 0.0
    for i in range(static.size - 1):
        slope = (static[i + 1] - static[i]) / step
        # beside the motion that the ramp of the torque forces, the shaft swings freely
        y = d - static[i] + lag * slope
        w = v - slope
        d = flow[i, 0] * y + flow[i, 1] * w + static[i + 1] - lag * slope
        v = flow[i, 2] * y + flow[i, 3] * w + slope
        twist[i + 1] = d
        rate[i + 1] = v
    return twist, rate


def known_voltage(
    signals: Signals, joint: int, values: Mapping[str, float], torque: np.ndarray
) -> dict[int, np.ndarray]:
    """Voltage [V] that the shaft makes along a measured motion."""
    inertia, rigid = link_side(signals, joint)
    passed = shaft_torque(signals, rigid, inertia, values["stiffness"], values["damping"])
    return on_links(signals, joint, passed - rigid, inertia)


def train(values: Mapping[str, float]) -> Train:
    """A spring between rotor and link."""
    return Train((values["stiffness"], values["damping"]), motor_share=values["motor_share"])


EFFECT = Kind(
    name="joint_elasticity",
    order=180,
    acts=TRANSMISSION,
    equation="tau = K (qm - ql) + B (qdm - qdl), motor_share Ia qddm = kT i - H qdm - tau",
    sentence="A drive that twists: the link swings against the rotor, with a resonance and, in "
    "the motor's position, an antiresonance.",
    parameters=(
        Parameter(
            "stiffness",
            "N.m/rad",
            10.0,
            1e7,
            "K, at the joint",
            role=Role.RATE,
            plausible=(2e3, 1e5),
            logarithmic=True,
            inverse=True,
        ),
        Parameter("damping", "N.m.s/rad", 0.0, 1000.0, "B, at the joint", default=5.0),
        MOTOR_SHARE,
    ),
    train=train,
    needs=Needs(ROTOR_INERTIA, "a rotor that can move against its link"),
    feigned=True,
    known_voltage=known_voltage,
    screening=Screening(elasticity, excitation="A dither or chirp up to 15 Hz, best without feedback.", fast=True),
    drawn_against=("acceleration",),
    example="joint_elasticity:joint=2,stiffness=2e4",
)
