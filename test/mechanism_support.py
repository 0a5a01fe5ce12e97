# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Mechanisms of one joint, and motions as the screening reads them, that several tests make."""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects import parse_effect
from puma_sim_core.effects.screening import Signals
from puma_sim_core.files import read_yaml
from puma_sim_core.plant.linkage.linkage_file import read_linkage
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant
from puma_sim_core.resources import config_path

NAMES = ("puma560", "pendulum", "slide")


def pendulum_mapping():
    return read_yaml(config_path("mechanisms", "pendulum.yaml"))


def pendulum(effects=(), **numbers):
    body = read_linkage(pendulum_mapping())
    return LinkagePlant.of(body, map(parse_effect, effects), numbers)


def signals_of(mechanism, run, voltage):
    """A run as the screening reads it, with exact velocities and accelerations."""
    theta, q, qd, qdd = mechanism.start, run.position, run.velocity, run.acceleration
    drive = mechanism.drive(theta)
    torque = mechanism.total_torque(theta, q, qd, qdd)
    step = float(run.time[1] - run.time[0])
    return Signals(
        time=run.time,
        step=step,
        segment=np.zeros(len(q), dtype=int),
        voltage=voltage,
        position=q,
        velocity=qd,
        acceleration=qdd,
        link_torque=mechanism.torque(theta, q, qd, qdd),
        gravity_torque=mechanism.gravity(theta, q),
        torque=torque,
        current=torque * drive.volts_per_torque / drive.resistance,
        enable=np.ones_like(q),
        link_inertia=mechanism.inertia(theta, q),
        motor_inertia=drive.motor_inertia,
        viscous=drive.viscous,
        volts_per_torque=drive.volts_per_torque,
        lag=drive.lag,
        emf=drive.emf,
        gear=mechanism.gear,
        torque_scale=mechanism.torque_scale,
        velocity_noise=np.full(mechanism.joints, 1e-6),
        quantum=np.zeros(mechanism.joints),
        ranges=mechanism.ranges,
        inertia=mechanism.inertia_matrix(theta, q),
        position_gradient=mechanism.position_gradient(theta, q, qd, qdd),
        library_sized=mechanism.library_sized,
    )
