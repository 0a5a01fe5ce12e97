# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Hypotheses of a library, the signals that their candidates read, and the columns of these."""

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from puma_sim_core.effects import Kind
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.data.sampling import Trajectory
from puma_sim_core.identify.screening.evidence import Key
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism import Mechanism


def signals_of(
    mechanism: Mechanism,
    theta: Floats,
    motion: Trajectory,
    velocity_noise: Floats,
    quantum: Floats,
    *,
    coupled: bool = True,
) -> Signals:
    """What candidates read along a motion. coupled : with what effects of transmissions and sensors read too."""
    q, qd, qdd = motion.position, motion.velocity, motion.acceleration
    drive = mechanism.drive(theta)
    link = mechanism.torque(theta, q, qd, qdd)
    torque = link + drive.motor_inertia * qdd + drive.viscous * qd
    inertia = mechanism.inertia_matrix(theta, q)
    links = mechanism.inertia(mechanism.start, q[:: FITTING.inertia_every]).mean(axis=0)

    def payload_torque(at: tuple[float, float, float]) -> Floats:
        found = mechanism.payload_torque(theta, at, q, qd, qdd)
        assert found is not None
        return found

    return Signals(
        time=motion.time,
        step=motion.step,
        segment=motion.segment,
        voltage=motion.voltage,
        position=q,
        velocity=qd,
        acceleration=qdd,
        link_torque=link,
        gravity_torque=mechanism.gravity(theta, q),
        torque=torque,
        current=torque * drive.volts_per_torque / drive.resistance,
        enable=motion.enable,
        link_inertia=np.diagonal(inertia, axis1=1, axis2=2),
        motor_inertia=drive.motor_inertia,
        mesh_share=links / (links + mechanism.drive(mechanism.start).motor_inertia),
        viscous=drive.viscous,
        volts_per_torque=drive.volts_per_torque,
        lag=drive.lag,
        emf=drive.emf,
        gear=np.asarray(mechanism.gear, dtype=float),
        torque_scale=np.asarray(mechanism.torque_scale, dtype=float),
        velocity_noise=velocity_noise,
        quantum=quantum,
        ranges=tuple(mechanism.ranges),
        gravity_tilt=mechanism.gravity_tilt(theta, q),
        payload_torque=payload_torque,
        inertia=inertia if coupled else None,
        position_gradient=mechanism.position_gradient(theta, q, qd, qdd) if coupled else None,
        library_sized=mechanism.library_sized,
    )


def hypotheses(library: Iterable[Kind], mechanism: Mechanism) -> Iterator[tuple[Kind, int | None]]:
    """(effect, joint) of each hypothesis that a mechanism may have: joint 1-based, None for the whole arm."""
    for kind in library:
        for joint in range(1, mechanism.joints + 1) if kind.per_joint else (None,):
            if mechanism.possible(kind.name, joint):
                yield kind, joint


def open_to(kind: Kind, joint: int | None, keys: Collection[Key]) -> bool:
    """Whether an effect may be added to a model with the effects `keys`: it is none of them, and the one that the joint
    has before it, where it may have several, is."""
    return (kind.name, joint) not in keys and (kind.before is None or (kind.before, joint) in keys)


def candidates(kind: Kind, joint: int | None, signals: Signals) -> list[Candidate]:
    """The candidates of a hypothesis; joint 1-based, None for the whole arm."""
    return screening_of(kind).candidates(signals, None if joint is None else joint - 1)


def screening_of(kind: Kind) -> Screening:
    """How an effect of the library is found in a log."""
    assert kind.screening is not None
    return kind.screening


def by_joint(candidate: Candidate, rows: int) -> dict[int, Floats]:
    """Joint (0-based) -> (n, p) columns of a candidate, 0 where a coefficient does not act on it."""
    columns = list(candidate.columns)
    out = {j: np.zeros((rows, len(candidate.mean))) for j in sorted({j for column in columns for j in column})}
    for n, column in enumerate(columns):
        for j, values in column.items():
            out[j][:, n] = values
    return out
