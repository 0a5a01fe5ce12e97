# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Misprints of chapter 6 and of appendix B: integration, constraints, the program's matrices."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.arm.third_order import acceleration_from_current, current_rate, joint_torque_per_ampere
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.chapter_5 import jerk_of_currents, motors, rate
from puma_sim_core.thesis.misprints.evidence import Between, Erratum, Evidence
from puma_sim_core.thesis.misprints.reference import POSES, RATES, VISCOUS, nominal

_VOLTS = np.random.default_rng(600).uniform(-40.0, 40.0, (len(POSES), 3))
_CURRENTS = np.random.default_rng(601).uniform(-8.0, 8.0, (len(POSES), 3))
_STEP = 1e-40


def jerk_6_2(q, qd, qdd, v, slips=()):
    """Third derivative (3,) [rad/s^3] by section 6.4's matrices, their misprints as switches.

    Slips: LMAT sign, LMAT rate, BMAT, JKMAT rate, JKMAT row 2, HMAT, KMAT, KMAT row 2.
    """
    arm = nominal()
    resistance, inductance, emf, torque = motors()
    r_k, l_k = resistance / torque, inductance / torque
    d, c, g = inertia(q, arm), coriolis(q, arm), gravity_torque(q, arm)
    g_rate = g if "LMAT rate" in slips else rate(gravity_torque, q, qd)
    c_rate = c if "JKMAT rate" in slips else rate(coriolis, q, qd)
    fmat = 2 * l_k[:, None] * (qd @ c)
    bmat = np.diag(l_k) if "BMAT" in slips else l_k[:, None] * rate(inertia, q, qd)
    gmat = r_k[:, None] * d
    hmat = np.diag(r_k * arm.motor_inertia + (VISCOUS if "HMAT" in slips else l_k * VISCOUS))
    jkmat = l_k[:, None] * (qd @ c_rate) + r_k[:, None] * (qd @ c)
    if "JKMAT row 2" in slips:
        jkmat[1] = qd[[0, 1, 1]] @ (l_k[1] * c_rate[1] + r_k[1] * c[1])
    friction = VISCOUS[[0, 2, 2]] if "KMAT row 2" in slips else VISCOUS
    kmat = np.diag(emf + (friction if "KMAT" in slips else r_k * friction))
    lmat = l_k * g_rate + r_k * g
    sign = 1.0 if "LMAT sign" in slips else -1.0
    right = v - (fmat + bmat + gmat + hmat) @ qdd - (jkmat + kmat) @ qd + sign * lmat
    return np.linalg.solve(l_k[:, None] * (d + np.diag(arm.motor_inertia)), right)


def _matrix(*slips):
    def evidence():
        arm = nominal()
        states = [
            (q, qd, acceleration_from_current(q, qd, i, arm, VISCOUS), v)
            for q, qd, i, v in zip(POSES, RATES, _CURRENTS, _VOLTS)
        ]
        return Evidence(
            "third derivative of the joint angles",
            "rad/s^3",
            "flow of the states (q, qd, i) by the complex step",
            np.array([jerk_of_currents(q, qd, i, v) for q, qd, i, v in zip(POSES, RATES, _CURRENTS, _VOLTS)]),
            np.array([jerk_6_2(*s) for s in states]),
            np.array([jerk_6_2(*s, slips=slips) for s in states]),
            1e-7,
        )

    return evidence


def rates(state, v):
    """x' of x = (q, qd, i), (9,), real or complex."""
    q, qd, current = state[:3], state[3:6], state[6:]
    arm = nominal()
    return np.concatenate([qd, acceleration_from_current(q, qd, current, arm), current_rate(qd, current, v, arm)])


def jacobian(state, v) -> np.ndarray:
    """(9, 9) derivative of the rates to the state [1/s], by the complex step."""
    columns = []
    for k in range(9):
        ahead = np.array(state, dtype=complex)
        ahead[k] += 1j * _STEP
        columns.append(rates(ahead, v).imag / _STEP)
    return np.array(columns).T


def growth(eigenvalues, step: float, order: int = 4) -> float:
    """Greatest factor by which a step [s] of the Runge-Kutta method of this order multiplies a mode
    whose exact motion decays."""
    z = step * eigenvalues[np.real(eigenvalues) < -1.0]
    return float(np.max(np.abs(sum(z**k / math.factorial(k) for k in range(order + 1)))))


def stability_limit(eigenvalues, order: int = 4) -> float:
    """Step [s] at which the first decaying mode starts to grow."""
    low, high = 1e-4, 0.1
    # growth above 1 at a step means growth above 1 at all greater ones here
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if growth(eigenvalues, middle, order) <= 1.0 else (low, middle)
    return low


def _eigenvalues():
    still = np.concatenate([[0.0, -np.pi / 2, np.pi / 2], np.zeros(6)])
    return np.linalg.eigvals(jacobian(still, np.zeros(3)))


def _fifty_milliseconds():
    values = _eigenvalues()
    return Evidence(
        "growth of a decaying mode in one step of RK4",
        "",
        "a decaying mode must not grow",
        Between(0.0, 1.0),
        growth(values, 0.005),
        growth(values, 0.050),
    )


def _thirty_five_microseconds():
    motor = nominal().motors[0]
    limit = stability_limit(np.array([-motor.resistance / motor.inductance]))
    return Evidence(
        "greatest useful step of RK4",
        "ms",
        "step at which the decay with L/R starts to grow",
        1e3 * limit,
        8.4,
        0.035,
        0.05,
    )


def _inputs_within_a_step():
    """q after one step with voltages that jump at its end; the record has one row a step."""
    start = np.concatenate([POSES[0], RATES[0], np.zeros(3)])
    h, here, there = 0.001, np.array([20.0, -15.0, 10.0]), np.array([-20.0, 15.0, 30.0])

    def step(middle, end):
        k1 = rates(start, here)
        k2 = rates(start + h / 2 * k1, middle)
        k3 = rates(start + h / 2 * k2, middle)
        k4 = rates(start + h * k3, end)
        return (start + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))[6:]

    exact = solve_ivp(lambda t, x: rates(x, here), (0, h), start, method="DOP853", rtol=1e-12, atol=1e-12).y[6:, -1]
    return Evidence(
        "motor currents after a step of 1 ms",
        "A",
        "adaptive integration (DOP853)",
        exact,
        step(here, here),
        step((here + there) / 2, there),
        1e-3,
    )


def _input_slope():
    """df/du at an input that is held."""
    _q, qd, current = POSES[0], RATES[0], _CURRENTS[0]
    slope = []
    for k in range(3):
        v = np.array(_VOLTS[0], dtype=complex)
        v[k] += 1j * _STEP
        slope.append(current_rate(qd, current, v, nominal())[k].imag / _STEP)
    return Evidence(
        "derivative of di/dt to the voltage",
        "A/(V.s)",
        "complex step",
        slope,
        [1 / m.inductance for m in nominal().motors],
        np.zeros(3),
        1e-9,
    )


def locked_inertias(q):
    """(right, by overwriting) effective inertia (3,) [kg.m^2] of each joint, others locked."""
    mass = reference.inertia(q) + np.diag(nominal().motor_inertia)
    return np.diag(mass), 1.0 / np.diag(np.linalg.inv(mass))


def _overwriting():
    upright = np.array([0.0, -np.pi / 2, np.pi / 2])
    right, overwritten = locked_inertias(upright)
    mass = reference.inertia(upright) + np.diag(nominal().motor_inertia)
    held = []
    for i in range(3):
        # unit torque on joint i, constraint torques on the two others: five equations
        others = np.eye(3)[[j for j in range(3) if j != i]]
        system = np.block([[mass, others.T], [others, np.zeros((2, 2))]])
        held.append(1.0 / np.linalg.solve(system, np.eye(5)[i])[i])
    return Evidence(
        "inertia of joints 1, 2, 3 with the others locked, arm upright",
        "kg.m^2",
        "constraint torques as unknowns (Lagrange multipliers)",
        held,
        right,
        overwritten,
        1e-10,
    )


def smallest_eigenvalue_of_d() -> float:
    """Smallest eigenvalue [kg.m^2] of D without motor inertias, on a grid of 5 degrees."""
    angles = np.radians(np.arange(-180.0, 180.0, 5.0))
    q2, q3 = np.meshgrid(angles, angles)
    poses = np.stack([np.zeros_like(q2), q2, q3], axis=-1)
    return float(np.min(np.linalg.eigvalsh(inertia(poses, nominal()))))


def _positive_definite():
    q = np.array([0.0, np.pi / 2, -np.pi / 2])
    return Evidence(
        "smallest eigenvalue of D over all poses",
        "kg.m^2",
        "independent D at q2 = 90, q3 = -90 deg",
        float(np.linalg.eigvalsh(reference.inertia(q))[0]),
        smallest_eigenvalue_of_d(),
        0.0,
        1e-3,
    )


def _sufficient():
    matrix = np.array([[1.0, -0.9, -0.9], [-0.9, 1.0, -0.9], [-0.9, -0.9, 1.0]])
    conditions = all(
        matrix[i, i] > 0 and (i == j or matrix[i, j] ** 2 < matrix[i, i] * matrix[j, j])
        for i in range(3)
        for j in range(3)
    )
    names = {True: "positive definite", False: "not positive definite"}
    ones = np.ones(3)
    return Evidence(
        "a matrix with 1 on its diagonal and -0.9 elsewhere",
        "",
        "x'Ax for x = (1, 1, 1)",
        names[bool(ones @ matrix @ ones > 0)],
        names[bool(np.linalg.eigvalsh(matrix)[0] > 0)],
        names[conditions],
    )


def _squares():
    """The condition at the pose of the first state: can all pairs meet it?"""
    d = reference.inertia(np.zeros(3)) + np.diag(nominal().motor_inertia)
    pairs = [(i, j) for i in range(3) for j in range(3) if i != j]
    return Evidence(
        "pairs (i, j) that meet the condition, D + Ia at q = 0",
        "",
        "minors of two rows that are positive",
        sum(bool(np.linalg.det(d[np.ix_(p, p)]) > 0) for p in map(list, pairs)),
        sum(bool(d[i, j] ** 2 < d[i, i] * d[j, j]) for i, j in pairs),
        sum(bool(d[i, i] ** 2 < d[i, i] * d[j, j]) for i, j in pairs),
    )


def _scaled_identity():
    arm = nominal()
    true = np.array([m.inductance / (m.back_emf * m.gear_ratio) for m in arm.motors])
    lkmat = np.array([m.inductance for m in arm.motors]) / joint_torque_per_ampere(arm)
    return Evidence(
        "diagonal of LKMAT, relative to its first element",
        "",
        "back-emf constants at the joints (ke N)",
        true / true[0],
        lkmat / lkmat[0],
        np.ones(3),
        1e-9,
    )


ROWS = (
    Erratum(
        "6.2 fifty",
        "sections 6.2.1 and 6.5, step",
        "h = 0.05 (50 mS) is accurate",
        "5 ms is the likely meaning",
        _fifty_milliseconds,
        "L/R is 3 ms; RK4 is stable up to 8.4 ms. 40 mS beside it would be 4 ms.",
    ),
    Erratum(
        "6.2 thirty-five",
        "section 6.2.1, greatest step",
        "0.035 mS",
        "8.4 ms, where RK4 stops being stable",
        _thirty_five_microseconds,
        "It contradicts the 50 mS of the sentence before; no one factor mends both.",
    ),
    Erratum(
        "6.8 input",
        "equations 6.8 to 6.10, input within a step",
        "v at r + 0.5 and r + 1",
        "v_r throughout, since it is held",
        _inputs_within_a_step,
        "Section 6.1 and appendix B hold the input over the step.",
    ),
    Erratum(
        "6.2 lock",
        "section 6.2.1, constrained joints",
        "integrate without constraint, then overwrite the joint's state",
        "take the joint's row and column out",
        _overwriting,
        "A mistake of method: the other joints answer with the inertia of a free chain.",
    ),
    Erratum("6.3 squares", "section 6.3, second condition", "d_ii^2 < d_ii d_jj", "d_ij^2 < d_ii d_jj", _squares),
    Erratum(
        "6.3 conditions",
        "section 6.3, proof",
        "the two conditions make D positive definite",
        "they are necessary, not sufficient",
        _sufficient,
    ),
    Erratum(
        "6.3 definite",
        "section 6.3, D without motor inertias",
        "positive definite",
        "not definite: its smallest eigenvalue is -0.405 kg.m^2",
        _positive_definite,
        "With zero products of inertia link 2 is no possible body. D + Ia is positive definite "
        "for this set, 0.760 kg.m^2 at least; that must be computed, it does not follow.",
    ),
    Erratum(
        "6.3 LKMAT",
        "section 6.3, LKMAT",
        "a scaled identity matrix",
        "L / (N kt): three different elements",
        _scaled_identity,
        "True of the printed F = kt i only; the gear ratios differ.",
    ),
    Erratum("6.4 LMAT sign", "section 6.4, second equation 6.2", "+ LMAT", "- LMAT", _matrix("LMAT sign")),
    Erratum("6.4 LMAT rate", "section 6.4, LMAT", "L D_i + R D_i", "L dG_i/dt + R G_i", _matrix("LMAT rate")),
    Erratum("6.4 BMAT", "section 6.4, BMAT", "diag(L/kT)", "diag(L/kT) dD/dt", _matrix("BMAT")),
    Erratum("6.4 JKMAT rate", "section 6.4, JKMAT", "L D^i + R D^i", "L dC^i/dt + R C^i", _matrix("JKMAT rate")),
    Erratum("6.4 JKMAT row", "section 6.4, JKMAT second row", "(x4 x5 x5)", "(x4 x5 x6)", _matrix("JKMAT row 2")),
    Erratum("6.4 HMAT", "section 6.4, HMAT", "R Ia / kT + H", "(R Ia + L H) / kT", _matrix("HMAT")),
    Erratum("6.4 KMAT", "section 6.4, KMAT", "ke N + H", "ke N + R H / kT", _matrix("KMAT")),
    Erratum("6.4 KMAT row", "section 6.4, KMAT second row", "H3", "H2", _matrix("KMAT row 2")),
    Erratum("B df/du", "appendix B, last line", "df/du = 0", "(df/du)(du/dt) = 0, because du/dt = 0", _input_slope),
)
