# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Misprints of chapter 5: motors and the third-order equations."""

from __future__ import annotations

import numpy as np

from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.arm.third_order import acceleration_from_current, current_rate, joint_torque_per_ampere
from puma_sim_core.thesis.misprints.evidence import Erratum, Evidence
from puma_sim_core.thesis.misprints.reference import ACCELERATIONS, JERKS, POSES, RATES, VISCOUS, gravity, nominal

_STEP = 1e-40


def motors():
    """R, L, ke N and kT of the three motors; each (3,)."""
    arm = nominal()
    values = [(m.resistance, m.inductance, m.back_emf * m.gear_ratio) for m in arm.motors]
    return (*np.array(values).T, joint_torque_per_ampere(arm))


def states():
    """(q, qd, qdd, qddd) at which forms are compared."""
    return list(zip(POSES, RATES, ACCELERATIONS, JERKS))


def joint_torque(q, qd, qdd):
    """F (3,) [N.m] of equation 5.4 with viscous friction; real or complex."""
    arm = nominal()
    return (
        (inertia(q, arm) + np.diag(arm.motor_inertia)) @ qdd
        + np.einsum("ijk,j,k->i", coriolis(q, arm), qd, qd)
        + VISCOUS * qd
        + gravity_torque(q, arm)
    )


def torque_rate(q, qd, qdd, qddd):
    """dF/dt (3,) [N.m/s], by a complex step along the motion."""
    ahead = 1j * _STEP
    return joint_torque(q + ahead * qd, qd + ahead * qdd, qdd + ahead * qddd).imag / _STEP


def rate(function, q, qd):
    """df(q)/dt by a complex step along the motion."""
    return function(q + 1j * _STEP * qd, nominal()).imag / _STEP


def motor_voltage(q, qd, qdd, qddd):
    """Voltage (3,) [V] that equation 5.1 needs for a motion."""
    resistance, inductance, emf, torque = motors()
    return (
        resistance / torque * joint_torque(q, qd, qdd) + inductance / torque * torque_rate(q, qd, qdd, qddd) + emf * qd
    )


def jerk_of_currents(q, qd, current, v):
    """Third derivative (3,) [rad/s^3] along the flow of the states (q, qd, i)."""
    arm = nominal()
    qdd = acceleration_from_current(q, qd, current, arm, VISCOUS)
    ahead = 1j * _STEP
    return (
        acceleration_from_current(
            q + ahead * qd, qd + ahead * qdd, current + ahead * current_rate(qd, current, v, arm), arm, VISCOUS
        ).imag
        / _STEP
    )


def equation_5_7(q, qd, qdd, qddd, slips=()):
    """Voltage (3,) [V] by equation 5.7, with its misprints as switches."""
    arm = nominal()
    resistance, inductance, emf, torque = motors()
    r_k, l_k = resistance / torque, inductance / torque
    d, c, g = inertia(q, arm), coriolis(q, arm), gravity_torque(q, arm)
    added = arm.motor_inertia
    mixed = np.einsum("ijk,j,k->i", c, qdd, qd)
    times = 3.0 if "three times" in slips else 2.0
    friction = r_k * VISCOUS * qd if "friction twice" in slips else l_k * VISCOUS * qdd
    return (
        l_k * (d @ qddd + added * qddd + times * mixed)
        + r_k * (d @ qdd + added * qdd + VISCOUS * qd)
        + l_k * (rate(inertia, q, qd) @ qdd)
        + l_k * np.einsum("ijk,j,k->i", rate(coriolis, q, qd), qd, qd)
        + r_k * np.einsum("ijk,j,k->i", c, qd, qd)
        + emf * qd
        + friction
        + l_k * rate(gravity_torque, q, qd)
        + r_k * g
    )


def _equation_5_7(slip):
    def evidence():
        return Evidence(
            "motor voltage",
            "V",
            "circuit 5.1 with dF/dt by the complex step",
            np.array([motor_voltage(*s) for s in states()]),
            np.array([equation_5_7(*s) for s in states()]),
            np.array([equation_5_7(*s, slips=(slip,)) for s in states()]),
            1e-9,
        )

    return evidence


def _gear_ratio():
    resistance, _, emf, torque = motors()
    constants = np.array([motor.torque_constant for motor in nominal().motors])
    stretched = np.array([0.0, 0.0, np.pi / 2])
    load = abs(gravity(stretched)[1])
    holding = [float((resistance / k * load)[1]) for k in (emf, torque, constants)]
    return Evidence(
        f"voltage that holds joint 2 of the stretched arm, {load:.2f} N.m",
        "V",
        "power: what the back-emf takes is what the joint gets (ke N)",
        *holding,
        0.02,
    )


def _torque_unit():
    motor = nominal().motors[0]
    return Evidence(
        "torque constant in N.m/A",
        "N.m/A",
        "power: in SI units the back-emf constant is the torque constant",
        motor.back_emf,
        motor.torque_constant,
        9.80665 * motor.torque_constant,
        0.002,
    )


def _derivative_sign():
    return Evidence(
        "left side of equation 5.4",
        "N.m",
        "torque of the bodies and friction",
        np.array([joint_torque(q, qd, qdd) for q, qd, qdd, _ in states()]),
        np.array([_from_voltage(*s) for s in states()]),
        np.array([torque_rate(*s) for s in states()]),
        1e-9,
    )


def _from_voltage(q, qd, qdd, qddd):
    """Torque N kt i with the current that circuit 5.1 leaves for the motion."""
    resistance, inductance, emf, torque = motors()
    v = motor_voltage(q, qd, qdd, qddd)
    di = torque_rate(q, qd, qdd, qddd) / torque
    return torque * (v - inductance * di - emf * qd) / resistance


def _friction_name():
    """Torque of the formula H qd at two speeds; Coulomb friction would not grow."""

    def formula(speed):
        return VISCOUS * speed

    coulomb = np.sign(2.0) / np.sign(1.0)
    ratio = float(np.mean(formula(2.0) / formula(1.0)))
    return Evidence(
        "friction at twice the speed, relative", "", "the thesis's formula H qd", ratio, 2.0, float(coulomb), 1e-12
    )


def _shape_of_g():
    """Shape of dx'/dv, by a complex step in each voltage."""
    arm = nominal()
    q, qd, _, _ = states()[0]
    columns = []
    for k in range(3):
        v = np.zeros(3, dtype=complex)
        v[k] = 1j * _STEP
        # the state (q, qd, qdd) moves with the voltage through di/dt alone
        third = acceleration_from_current(q, qd, current_rate(qd, np.zeros(3), v, arm), arm)
        columns.append(np.concatenate([np.zeros(6), np.imag(third) / _STEP]))
    rows, width = np.array(columns).T.shape
    return Evidence(
        "shape of g(x)", "", "derivative of the nine rates to the three voltages", f"{rows} x {width}", "9 x 3", "3 x 9"
    )


def _ninth_state():
    rng = np.random.default_rng(9)
    q, qd, qdd = rng.normal(size=(3, 40, 3))
    full = np.hstack([q, qd, qdd])
    printed = np.hstack([q, qd, qdd[:, :2], qd[:, 2:]])

    def rank(states_):
        return int(np.linalg.matrix_rank(states_))

    return Evidence(
        "independent numbers in the state x1 to x9",
        "",
        "order of three joints with motors: three each",
        9,
        rank(full),
        rank(printed),
    )


def _motor_angle():
    return Evidence(
        "what w stands for", "", "legend of figure 5.1", "motor position", "motor position", "joint position"
    )


ROWS = (
    Erratum(
        "5.1 unit",
        "section 5.1, unit of the torque constant",
        "0.2611 kg.m/amp",
        "0.2611 N.m/A",
        _torque_unit,
        "ke = 0.26 V.s/rad and kt must agree in SI units.",
    ),
    Erratum(
        "5.2 gear",
        "equation 5.2",
        "F = kt i",
        "F = N kt i at the joint",
        _gear_ratio,
        "Only with the printed form, or with open circuits, does the arm fall as in plot 7.3.",
    ),
    Erratum(
        "5.3 w",
        "section 5.1, before equation 5.3",
        "the joint position is w",
        "the motor position is w = N q",
        _motor_angle,
    ),
    Erratum(
        "5.2 Coulomb",
        "sections 5.2 and 7.3, friction",
        "modelled as Coulomb friction",
        "viscous friction, H qd",
        _friction_name,
    ),
    Erratum("5.4 dot", "equation 5.4, left side", "dF_i/dt", "F_i", _derivative_sign),
    Erratum("5.7 count", "equation 5.7, the term C qdd qd", "2 + 1 times", "2 times", _equation_5_7("three times")),
    Erratum(
        "5.7 friction",
        "equation 5.7, friction",
        "(R/kT) H qd twice",
        "(R/kT) H qd and (L/kT) H qdd",
        _equation_5_7("friction twice"),
    ),
    Erratum("5.8 x9", "section 5.3, state x9", "qd3", "qdd3", _ninth_state, "A dot that print or scan lost."),
    Erratum("5.8 shape", "section 5.3, g(x)", "in R^(3 x 9)", "in R^(9 x 3)", _shape_of_g),
)
