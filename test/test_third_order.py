# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The third-order form of chapter 5 is the same system as the motor currents beside the rigid body.

Complex steps have no truncation error, so forms that are equal in exact arithmetic must agree to
rounding, which the solution with D + Ia amplifies a little: 1e-10 relative leaves a wide margin.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from puma_sim_core.arm.parameters import load_parameters, parameter_sets
from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.arm.third_order import (
    acceleration_from_current,
    current_rate,
    jerk,
    joint_torque_per_ampere,
    matrices,
)
from puma_sim_core.errors import ParameterError

FORMS = ("physical", "printed")
VISCOUS = (0.3, 0.5, 0.2)
VOLTAGE = np.array([20.0, -15.0, 10.0])
START = np.array([0.1, -0.4, 0.7]), np.array([0.3, -0.2, 0.5]), np.array([0.5, -1.0, 0.8])
#: q(0.5 s) from START with VOLTAGE held: regression values of the corrected model
ENDS = {"physical": (0.68745378, -0.6102092, 1.07667885), "printed": (0.30113443, 0.48721605, 0.90871915)}


@pytest.fixture(params=parameter_sets())
def arm(request):
    return load_parameters(request.param)


def random_states(count, seed=5):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield (rng.uniform(-math.pi, math.pi, 3), rng.uniform(-2, 2, 3), rng.uniform(-6, 6, 3), rng.uniform(-40, 40, 3))


@pytest.mark.parametrize("form", FORMS)
def test_jerk_is_the_derivative_of_the_acceleration_along_the_current_form(arm, form):
    # the lumped current form knows nothing of Ddot, Cdot, Gdot: its flow is differentiated whole
    e = 1e-40j
    for q, qd, current, v in random_states(30):
        qdd = acceleration_from_current(q, qd, current, arm, VISCOUS, form)
        rate = current_rate(qd, current, v, arm)
        flow = acceleration_from_current(q + e * qd, qd + e * qdd, current + e * rate, arm, VISCOUS, form)
        expected = flow.imag / e.imag
        result = jerk(q, qd, qdd, v, arm, VISCOUS, form)
        assert np.max(np.abs(result - expected)) <= 1e-10 * np.max(np.abs(expected))


@pytest.mark.parametrize("form", FORMS)
def test_named_matrices_add_up_to_the_row_of_the_model(arm, form):
    # (L/kT) M qddd = v - ke N qd - (R/kT) F - (L/kT) dF/dt without its part in qddd
    h = 1e-40
    for q, qd, current, v in random_states(10, seed=8):
        m = matrices(q, qd, arm, VISCOUS, form)
        qdd = acceleration_from_current(q, qd, current, arm, VISCOUS, form)
        d, c = inertia(q, arm) + np.diag(arm.motor_inertia), coriolis(q, arm)

        def dot(function):
            return function(q + 1j * h * qd, arm).imag / h

        force = d @ qdd + np.einsum("ijk,j,k->i", c, qd, qd) + VISCOUS * qd + gravity_torque(q, arm)
        rest = (
            dot(inertia) @ qdd
            + 2 * np.einsum("ijk,j,k->i", c, qd, qdd)
            + np.einsum("ijk,j,k->i", dot(coriolis), qd, qd)
            + VISCOUS * qdd
            + dot(gravity_torque)
        )
        constant = joint_torque_per_ampere(arm, form)
        emf = np.array([motor.back_emf * motor.gear_ratio for motor in arm.motors])
        left = v - emf * qd - 1.6 / constant * force - 0.0048 / constant * rest
        named = v - (m.FMAT + m.BMAT + m.GMAT + m.HMAT) @ qdd - (m.JKMAT + m.KMAT) @ qd - m.LMAT
        np.testing.assert_allclose(named, left, rtol=0, atol=1e-10 * np.max(np.abs(left)))
        np.testing.assert_allclose(m.Dbar, m.LKMAT @ d, rtol=1e-14)


def test_a_still_arm_needs_the_current_of_its_weight(arm):
    q = np.array([0.4, -0.3, 1.1])
    current = gravity_torque(q, arm) / joint_torque_per_ampere(arm)
    assert np.max(np.abs(acceleration_from_current(q, np.zeros(3), current, arm))) < 1e-12
    # and the voltage of that current through the resistance keeps it so
    v = np.array([motor.resistance for motor in arm.motors]) * current
    assert np.max(np.abs(jerk(q, np.zeros(3), np.zeros(3), v, arm))) < 1e-10


@pytest.mark.parametrize("form", FORMS)
def test_both_forms_reach_the_regression_values(form):
    integrate = pytest.importorskip("scipy.integrate")
    arm = load_parameters("bejczy")
    q, qd, current = START
    qdd = acceleration_from_current(q, qd, current, arm, VISCOUS, form)

    def third_order(_, x):
        return np.concatenate([x[3:], jerk(x[:3], x[3:6], x[6:], VOLTAGE, arm, VISCOUS, form)])

    def with_currents(_, x):
        return np.concatenate(
            [
                x[3:6],
                acceleration_from_current(x[:3], x[3:6], x[6:], arm, VISCOUS, form),
                current_rate(x[3:6], x[6:], VOLTAGE, arm),
            ]
        )

    ends = []
    for function, state in ((third_order, [q, qd, qdd]), (with_currents, [q, qd, current])):
        run = integrate.solve_ivp(function, (0.0, 0.5), np.concatenate(state), method="DOP853", rtol=1e-12, atol=1e-13)
        assert run.success
        ends.append(run.y[:, -1])
        np.testing.assert_allclose(run.y[:3, -1], ENDS[form], rtol=0, atol=1e-7)
    # the two runs end in the same state, the accelerations from the currents included
    third, currents = ends
    np.testing.assert_allclose(third[:6], currents[:6], rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        third[6:],
        acceleration_from_current(currents[:3], currents[3:6], currents[6:], arm, VISCOUS, form),
        rtol=0,
        atol=1e-8,
    )


def test_effect_of_the_misprint_in_equation_5_7_is_seen():
    # printed, the term with qdd and qd stands three times; the tolerance above is 1e-10
    arm = load_parameters("bejczy")
    q, qd, current = START
    qdd = acceleration_from_current(q, qd, current, arm)
    m = matrices(q, qd, arm)
    extra = np.linalg.solve(m.Dbar, m.FMAT @ qdd / 2)
    assert np.max(np.abs(extra)) > 1e-6 * np.max(np.abs(jerk(q, qd, qdd, VOLTAGE, arm)))


def test_motor_constants_may_differ_between_joints():
    arm = load_parameters("bejczy")
    motors = (arm.motors[0], replace(arm.motors[1], resistance=0.8, inductance=0.002), arm.motors[2])
    other = replace(arm, motors=motors)
    q, qd, current = START
    e = 1e-40j
    qdd = acceleration_from_current(q, qd, current, other)
    rate = current_rate(qd, current, VOLTAGE, other)
    flow = acceleration_from_current(q + e * qd, qd + e * qdd, current + e * rate, other)
    np.testing.assert_allclose(jerk(q, qd, qdd, VOLTAGE, other), flow.imag / e.imag, rtol=1e-10)


def test_unknown_torque_form_is_refused():
    arm = load_parameters("bejczy")
    with pytest.raises(ParameterError, match="torque_form 'other'; expected physical or printed"):
        jerk(*START, VOLTAGE, arm, torque_form="other")
