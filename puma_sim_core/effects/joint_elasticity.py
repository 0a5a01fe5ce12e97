# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An elastic drive: rotor and link are two masses with a spring between."""

import numpy as np

from puma_sim_core.effects.base import RATE, ROTOR_INERTIA, TRANSMISSION, Kind, Needs, Parameter, Train
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, ByJoint, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, is_arm, stretches, when_moving
from puma_sim_core.effects.shared.drive_train import MOTOR_SHARE, beginning, link_side, on_links
from puma_sim_core.jit import Table, Vec, compiled

#: shares of critical damping, with frequencies [Hz] of the link against a locked rotor. Real drives are damped less,
#: but then noise rings in the simulated link, and its phase is lost unless the frequency is known to a percent
_RESONANCES = ((0.05, np.geomspace(3.0, 45.0, 28)), (0.15, np.geomspace(3.0, 45.0, 16)))
#: and that are run in the model
_RUN = (0.05, np.geomspace(3.0, 45.0, 10))
#: stiffnesses of the arm's drives [N.m/rad], beyond the library's on both sides
_STIFFNESSES = (2e3, 1.2e5)


@when_moving
def elasticity(signals: Signals, joint: int) -> list[Candidate]:
    """Torque through an elastic shaft less that through a rigid one, with coefficient 1, for a grid of the link's
    frequency and of the damping."""
    shafts = (_shaft(signals, joint, share, f) for share, frequencies in _RESONANCES for f in frequencies)
    return [_candidate([_cost(signals, joint, **shaft)], shaft) for shaft in shafts if shaft is not None]


@when_moving
def runs(signals: Signals, joint: int) -> list[Candidate]:
    """Candidates of a coarser grid, without columns."""
    share, frequencies = _RUN
    shafts = (_shaft(signals, joint, share, f) for f in frequencies)
    return [_candidate([], shaft) for shaft in shafts if shaft is not None]


def _shaft(signals: Signals, joint: int, share: float, frequency: float) -> dict[str, float] | None:
    """Stiffness and damping of a shaft by the link's frequency [Hz]; None of one that is beyond the arm's."""
    inertia = float(link_side(signals, joint)[0].mean())
    stiffness = float(inertia * (2.0 * np.pi * frequency) ** 2)
    if is_arm(signals) and not _STIFFNESSES[0] <= stiffness <= _STIFFNESSES[1]:
        return None
    return {"stiffness": stiffness, "damping": float(2.0 * share * np.sqrt(stiffness * inertia))}


def _candidate(columns: list[ByJoint], shaft: dict[str, float]) -> Candidate:
    return candidate(columns, [1.0], [0.12], lambda c, **shaft: shaft, shaft, VOLTAGE_COLUMN, fixed=True)


def _cost(signals: Signals, joint: int, stiffness: float, damping: float) -> ByJoint:
    """Voltages of the torque through a shaft K, B less that through a rigid one, under its rotor's motion.

    The twist d obeys M d'' + B d' + K d = torque, the one of a rigid shaft: solved exactly between samples for a torque
    that changes linearly and an inertia that stays.
    """
    inertia, rigid = link_side(signals, joint)
    step, decay = signals.step, damping / (2.0 * inertia)
    turn = np.sqrt(np.maximum(stiffness / inertia - decay**2, 1e-12))
    shrunk = np.exp(-decay * step)
    s, c = shrunk * np.sin(turn * step) / turn, shrunk * np.cos(turn * step)
    flow = np.stack([c + decay * s, s, -(stiffness / inertia) * s, c - decay * s], axis=1)
    passed = np.empty_like(rigid)
    for part in stretches(signals):
        static = np.ascontiguousarray(rigid[part]) / stiffness
        start = beginning(signals, static)
        twist, rate = _swing(np.ascontiguousarray(flow[part]), static, step, damping / stiffness, start)
        passed[part] = stiffness * twist + damping * rate
    return on_links(signals, joint, passed - rigid, inertia)


@compiled
def _swing(flow: Table, static: Table, step: Table, lag: Table, begins: Table) -> Vec:
    """Twist and its rate (n,), from rest at a twist on; flow (n, 4) steps the free motion."""
    twist, rate = static.copy(), static.copy()
    d, v = begins, 0.0
    twist[0], rate[0] = d, v
    for i in range(static.size - 1):
        slope = (static[i + 1] - static[i]) / step
        # beside the motion that the ramp of the torque forces, the shaft swings freely
        y = d - static[i] + lag * slope
        w = v - slope
        d = flow[i, 0] * y + flow[i, 1] * w + static[i + 1] - lag * slope
        v = flow[i, 2] * y + flow[i, 3] * w + slope
        twist[i + 1], rate[i + 1] = d, v
    return twist, rate


EFFECT = Kind(
    name="joint_elasticity",
    order=180,
    acts=TRANSMISSION,
    equation="tau = K (qm - ql) + B (qdm - qdl), motor_share Ia qddm = kT i - H qdm - tau",
    sentence="A drive that twists: the link swings against the rotor, with a resonance and, in "
    "the motor's position, an antiresonance.",
    parameters=(
        Parameter("stiffness", "N.m/rad", 1e-3, 1e7, "K, at the joint", RATE, (2e3, 1e5), inverse=True, steps=0.5),
        Parameter("damping", "N.m.s/rad", 0.0, 1e5, "B, at the joint", default=5.0),
        MOTOR_SHARE,
    ),
    train=lambda v: Train((v["stiffness"], v["damping"]), motor_share=v["motor_share"]),
    needs=Needs(ROTOR_INERTIA, "a rotor that can move against its link"),
    feigned=True,
    known_voltage=lambda signals, joint, v, _: _cost(signals, joint, v["stiffness"], v["damping"]),
    screening=Screening(elasticity, "A dither or chirp up to 15 Hz, best without feedback.", fast=True, runs=runs),
    drawn_against=("acceleration",),
    example="joint_elasticity:joint=2,stiffness=2e4",
)
