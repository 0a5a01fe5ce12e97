# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Proofs of the misprints of chapter 5: motors and the third-order equations."""

import numpy as np

from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.arm.third_order import acceleration_from_current, current_rate, joint_torque_per_ampere, matrices
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.evidence import read_errata
from puma_sim_core.thesis.misprints.reference import POSES, RATES, VISCOUS, along, nominal, over


def motors():
    """R, L, ke N and kT of the three motors; each (3,)."""
    values = [(m.resistance, m.inductance, m.back_emf * m.gear_ratio) for m in nominal().motors]
    return (*np.array(values).T, joint_torque_per_ampere(nominal()))


def states():
    """(q, qd, qdd, qddd) at which forms are compared."""
    return list(zip(POSES, RATES, reference.ACCELERATIONS, reference.JERKS))


def joint_torque(q, qd, qdd, _=None):
    """F (3,) [N.m] of equation 5.4 with viscous friction; real or complex."""
    mass, against = inertia(q, nominal()) + np.diag(nominal().motor_inertia), gravity_torque(q, nominal())
    return mass @ qdd + np.einsum("ijk,j,k->i", coriolis(q, nominal()), qd, qd) + VISCOUS * qd + against


def torque_rate(q, qd, qdd, qddd):
    """dF/dt (3,) [N.m/s], by a complex step along the motion."""
    return along(joint_torque, (q, qd), (qd, qdd), (qdd, qddd))


def motor_voltage(q, qd, qdd, qddd):
    """Voltage (3,) [V] that equation 5.1 needs for a motion."""
    resistance, inductance, emf, torque = motors()
    return (resistance * joint_torque(q, qd, qdd) + inductance * torque_rate(q, qd, qdd, qddd)) / torque + emf * qd


def jerk_of_currents(q, qd, current, v):
    """Third derivative (3,) [rad/s^3] along the flow of the states (q, qd, i)."""

    def acceleration(q, qd, current):
        return acceleration_from_current(q, qd, current, nominal(), VISCOUS)

    rates = qd, acceleration(q, qd, current), current_rate(qd, current, v, nominal())
    return along(acceleration, *zip((q, qd, current), rates))


def prove_equation_5_7(slip):
    resistance, inductance, _, torque = motors()

    def voltage(q, qd, qdd, qddd, slip=None):
        m = matrices(q, qd, nominal(), VISCOUS)
        count = 1.5 if slip == "three times" else 1.0
        v = m.Dbar @ qddd + (count * m.FMAT + m.BMAT + m.GMAT + m.HMAT) @ qdd + (m.JKMAT + m.KMAT) @ qd + m.LMAT
        return v + (slip == "friction twice") * VISCOUS * (resistance * qd - inductance * qdd) / torque

    return over(states(), motor_voltage, voltage, lambda *state: voltage(*state, slip))


def prove_gear_ratio():
    resistance, _, emf, torque = motors()
    load = abs(reference.gravity(np.array([0.0, 0.0, np.pi / 2]))[1])
    constants = emf, torque, np.array([motor.torque_constant for motor in nominal().motors])
    return ((resistance / constant * load)[1] for constant in constants)


def prove_unit_of_torque(gravity):
    motor = nominal().motors[0]
    return motor.back_emf, motor.torque_constant, gravity * motor.torque_constant


def prove_left_side():
    resistance, inductance, emf, torque = motors()

    def from_voltage(q, qd, qdd, qddd):
        drop = inductance / torque * torque_rate(q, qd, qdd, qddd)
        return torque * (motor_voltage(q, qd, qdd, qddd) - drop - emf * qd) / resistance

    return over(states(), joint_torque, from_voltage, torque_rate)


def prove_friction_at_twice_the_speed(correct, printed):
    return np.mean(VISCOUS * 2.0 / VISCOUS), correct, printed


def prove_shape_of_g(correct, printed):
    def rates(v):
        # of x = (q, qd, qdd) the voltage moves the last alone, through di/dt
        rate = current_rate(RATES[0], np.zeros(3), v, nominal())
        return np.concatenate([np.zeros(6), acceleration_from_current(POSES[0], RATES[0], rate, nominal())])

    slopes = np.column_stack([along(rates, (np.zeros(3), unit)) for unit in np.eye(3)])
    return " x ".join(map(str, slopes.shape)), correct, printed


def prove_ninth_state(reference):
    q, qd, qdd = np.random.default_rng(9).normal(size=(3, 40, 3))
    correct, printed = np.hstack([q, qd, qdd]), np.hstack([q, qd, qdd[:, :2], qd[:, 2:]])
    return reference, *map(int, np.linalg.matrix_rank([correct, printed]))


ROWS = read_errata("errata_chapter_5.yaml", globals())
