# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Proofs of the misprints of chapter 6 and of appendix B: integration, constraints, the program's matrices."""

import math

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.arm.third_order import acceleration_from_current, current_rate, matrices
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.chapter_5 import jerk_of_currents, motors
from puma_sim_core.thesis.misprints.evidence import read_errata
from puma_sim_core.thesis.misprints.reference import POSES, RATES, VISCOUS, along, nominal, over

VOLTS = np.random.default_rng(600).uniform(-40.0, 40.0, (len(POSES), 3))
CURRENTS = np.random.default_rng(601).uniform(-8.0, 8.0, (len(POSES), 3))
UPRIGHT = np.array([0.0, -np.pi / 2, np.pi / 2])


def jerk_6_2(q, qd, qdd, v, slips=()):
    """Third derivative (3,) [rad/s^3] by section 6.4's matrices, with misprints by the names in `as_printed`."""
    arm, m = nominal(), matrices(q, qd, nominal(), VISCOUS)
    resistance, inductance, emf, torque = motors()
    r_k, l_k = resistance / torque, inductance / torque
    c, g = coriolis(q, arm), gravity_torque(q, arm)
    second_row = qd[[0, 1, 1]] @ (l_k[1] * along(lambda x: coriolis(x, arm), (q, qd))[1] + r_k[1] * c[1])
    as_printed = {
        "LMAT sign": {"LMAT": -m.LMAT},
        "LMAT rate": {"LMAT": l_k * g + r_k * g},
        "BMAT": {"BMAT": m.LKMAT},
        "JKMAT rate": {"JKMAT": l_k[:, None] * (qd @ c) + r_k[:, None] * (qd @ c)},
        "JKMAT row 2": {"JKMAT": np.array([m.JKMAT[0], second_row, m.JKMAT[2]])},
        "HMAT": {"HMAT": np.diag(r_k * arm.motor_inertia + VISCOUS)},
        "KMAT": {"KMAT": np.diag(emf + VISCOUS)},
        "KMAT row 2": {"KMAT": np.diag(emf + r_k * VISCOUS[[0, 2, 2]])},
    }
    for slip in slips:
        m = m._replace(**as_printed[slip])
    right = v - (m.FMAT + m.BMAT + m.GMAT + m.HMAT) @ qdd - (m.JKMAT + m.KMAT) @ qd - m.LMAT
    return np.linalg.solve(m.Dbar, right)


def prove_matrix(slip):
    def jerk(q, qd, current, v, *slips):
        return jerk_6_2(q, qd, acceleration_from_current(q, qd, current, nominal(), VISCOUS), v, slips)

    states = list(zip(POSES, RATES, CURRENTS, VOLTS))
    return over(states, jerk_of_currents, jerk, lambda *state: jerk(*state, slip))


def rates(state, v):
    """x' of x = (q, qd, i), (9,), real or complex."""
    q, qd, current = state[:3], state[3:6], state[6:]
    arm = nominal()
    return np.concatenate([qd, acceleration_from_current(q, qd, current, arm), current_rate(qd, current, v, arm)])


def jacobian(state, v) -> np.ndarray:
    """(9, 9) derivative of the rates to the state [1/s], by the complex step."""
    return np.array([along(lambda x: rates(x, v), (state, unit)) for unit in np.eye(9)]).T


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


def prove_growth_in_a_step(reference, correct, printed):
    modes = np.linalg.eigvals(jacobian(np.concatenate([UPRIGHT, np.zeros(6)]), np.zeros(3)))
    return reference, growth(modes, correct), growth(modes, printed)


def prove_greatest_step(correct, printed):
    motor = nominal().motors[0]
    return 1e3 * stability_limit(np.array([-motor.resistance / motor.inductance])), correct, printed


def prove_input_within_a_step(voltage, next_voltage, step):
    start = np.concatenate([POSES[0], RATES[0], np.zeros(3)])
    here, there = np.array(voltage), np.array(next_voltage)

    def currents(middle, end):
        k1 = rates(start, here)
        k2 = rates(start + step / 2 * k1, middle)
        k3 = rates(start + step / 2 * k2, middle)
        k4 = rates(start + step * k3, end)
        return (start + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4))[6:]

    exact = solve_ivp(lambda _, x: rates(x, here), (0, step), start, method="DOP853", rtol=1e-12, atol=1e-12)
    return exact.y[6:, -1], currents(here, here), currents((here + there) / 2, there)


def prove_input_slope(printed):
    slopes = [along(lambda v: current_rate(RATES[0], CURRENTS[0], v, nominal()), (VOLTS[0], e)) for e in np.eye(3)]
    return np.diag(slopes), [1 / motor.inductance for motor in nominal().motors], printed


def with_motors(q) -> np.ndarray:
    """D + Ia (3, 3) [kg.m^2], independent of the closed form."""
    return reference.inertia(q) + np.diag(nominal().motor_inertia)


def locked_inertias(q):
    """(right, by overwriting) effective inertia (3,) [kg.m^2] of each joint, others locked."""
    mass = with_motors(q)
    return np.diag(mass), 1.0 / np.diag(np.linalg.inv(mass))


def prove_locked_joints():
    held = []
    for i in range(3):
        # unit torque on joint i, constraint torques on the two others: five equations
        others = np.delete(np.eye(3), i, axis=0)
        system = np.block([[with_motors(UPRIGHT), others.T], [others, np.zeros((2, 2))]])
        held.append(1.0 / np.linalg.solve(system, np.eye(5)[i])[i])
    return held, *locked_inertias(UPRIGHT)


def smallest_eigenvalue_of_d() -> float:
    """Smallest eigenvalue [kg.m^2] of D without motor inertias, on a grid of 5 degrees."""
    angles = np.radians(np.arange(-180.0, 180.0, 5.0))
    poses = np.stack(np.meshgrid(0.0, angles, angles, indexing="ij"), axis=-1)
    return float(np.min(np.linalg.eigvalsh(inertia(poses, nominal()))))


def prove_positive_definite(pose, printed):
    return np.linalg.eigvalsh(reference.inertia(np.radians(pose)))[0], smallest_eigenvalue_of_d(), printed


def prove_conditions():
    matrix, ones = 1.9 * np.eye(3) - 0.9, np.ones(3)
    # the two conditions: elements of the diagonal and minors of two rows positive
    diagonal = np.diag(matrix)
    minors = (np.outer(diagonal, diagonal) - matrix**2)[~np.eye(3, dtype=bool)]
    meets = np.all(diagonal > 0) and np.all(minors > 0)
    answers = ones @ matrix @ ones > 0, np.linalg.eigvalsh(matrix)[0] > 0, meets
    return ("positive definite" if answer else "not positive definite" for answer in answers)


def prove_squares():
    d = with_motors(np.zeros(3))
    i, j = np.nonzero(~np.eye(3, dtype=bool))
    minors = np.array([np.linalg.det(d[np.ix_(pair, pair)]) for pair in zip(i, j)])
    limit = d[i, i] * d[j, j]
    return (np.count_nonzero(meets) for meets in (minors > 0, d[i, j] ** 2 < limit, d[i, i] ** 2 < limit))


def prove_scaled_identity(printed):
    _, inductance, emf, torque = motors()
    return *((inductance / constant) / (inductance / constant)[0] for constant in (emf, torque)), printed


ROWS = read_errata("errata_chapter_6.yaml", globals())
