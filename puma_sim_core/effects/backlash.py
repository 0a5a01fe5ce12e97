# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Backlash between the teeth of a gear."""

from math import ceil

import numpy as np

from puma_sim_core.effects.base import RATE, ROTOR_INERTIA, SIZE, TRANSMISSION, Kind, Needs, Parameter, Train
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, ByJoint, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, is_arm, of_travel, stretches, visible, when_moving
from puma_sim_core.effects.shared.drive_train import MOTOR_SHARE, beginning, link_side, on_links
from puma_sim_core.jit import Table, compiled

#: gaps [rad]
_GAPS = np.geomspace(1.5e-4, 4e-3, 13)
#: stiffness and damping of teeth in contact on the arm, in the screening and as the default of a simulated effect; the
#: priors of the parameters, which a fit goes by, are those of machines
_STIFFNESS, _DAMPING = 2e5, 100.0
#: least share of critical damping of the contact. The rotor recoils from an impact, and back-EMF damps it, faster than
#: the filtered motion shows: with the damping of the teeth alone the simulated link would bounce
_LEAST_DAMPING = 0.8


@when_moving
def backlash(signals: Signals, joint: int) -> list[Candidate]:
    """Torque through teeth with backlash less that through a rigid joint, with coefficient 1, for a grid of the gap."""
    contact = _contact(signals, joint)
    return visible(_candidate([_cost(signals, joint, gap, **contact)], gap, contact) for gap in _gaps(signals, joint))


@when_moving
def runs(signals: Signals, joint: int) -> list[Candidate]:
    """Candidates of the same grid, without columns."""
    contact = _contact(signals, joint)
    return [_candidate([], gap, contact) for gap in _gaps(signals, joint)]


def _gaps(signals: Signals, joint: int) -> list[float]:
    """Gaps [rad] of the grid."""
    found: list[float] = (_GAPS * of_travel(signals, joint)).tolist()
    return found


def _contact(signals: Signals, joint: int) -> dict[str, float]:
    """Stiffness and damping of teeth in contact: of the arm's, or of a link that swings against them at 60 Hz."""
    if is_arm(signals):
        return {"stiffness": _STIFFNESS, "damping": _DAMPING}
    inertia = float(link_side(signals, joint)[0].mean())
    stiffness = float(inertia * (2.0 * np.pi * 60.0) ** 2)
    return {"stiffness": stiffness, "damping": float(0.3 * float(np.sqrt(stiffness * inertia)))}


def _candidate(columns: list[ByJoint], gap: float, contact: dict[str, float]) -> Candidate:
    grid = {"gap": gap}
    return candidate(columns, [1.0], [0.15], lambda c, **grid: grid | contact, grid, VOLTAGE_COLUMN, fixed=True)


def _cost(signals: Signals, joint: int, gap: float, stiffness: float, damping: float) -> ByJoint:
    """Voltages of the torque through teeth less that through a rigid joint, under the measured motion of the rotor,
    averaged over a sample: an impact is shorter than one."""
    inertia, rigid = link_side(signals, joint)
    damping = max(damping, float(2.0 * _LEAST_DAMPING * np.sqrt(stiffness * inertia.mean())))
    fastest = float(np.sqrt(stiffness / inertia.min()))
    parts = max(int(ceil(signals.step * fastest / 0.12)), 1)
    passed = np.empty_like(rigid)
    for part in stretches(signals):
        asked, mass = np.ascontiguousarray(rigid[part]), np.ascontiguousarray(inertia[part])
        begins, substep = beginning(signals, asked), signals.step / parts
        passed[part] = _knock(asked, mass, substep, parts, 0.5 * gap, stiffness, damping, begins)
    return on_links(signals, joint, passed - rigid, inertia)


@compiled
def _knock(
    torque: Table, inertia: Table, step: float, parts: int, half: float, stiffness: float, damping: float, begins: float
) -> Table:
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
            SIZE,
            (5e-5, 5e-3),
            softened_by="stiffness",
            steps=1.0,
        ),
        Parameter(
            "stiffness", "N.m/rad", 1e-2, 1e7, "K of the teeth in contact", RATE, default=_STIFFNESS, prior=(5e5, 2.5)
        ),
        Parameter("damping", "N.m.s/rad", 0.0, 1e5, "B of the teeth in contact", default=_DAMPING, prior=(150.0, 2.5)),
        MOTOR_SHARE,
    ),
    train=lambda v: Train((v["stiffness"], v["damping"]), v["gap"], v["motor_share"]),
    vanishes=lambda values: values["gap"] == 0.0,
    needs=Needs(ROTOR_INERTIA, "a rotor that can move against its link"),
    known_voltage=lambda signals, joint, v, _: _cost(signals, joint, v["gap"], v["stiffness"], v["damping"]),
    screening=Screening(
        backlash,
        "Changes of sign of the torque at the link: bang-bang on joint 1, upright or hanging links on joints 2 and 3.",
        unseen=(("gap", 2e-4), ("stiffness", 5e5), ("damping", 150.0)),
        fast=True,
        runs=runs,
    ),
    drawn_against=("link_torque", "torque"),
    example="backlash:joint=2,gap=0.001",
)
