# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether feedback in the recording makes a delay or an elasticity out of noise.

Under position control the voltage answers to the noise of the measured position and to what pushes the joint.
Regressors made of the voltage's or the acceleration's fast part are then correlated with the residual, and their
coefficients are biased. The test is that of Durbin, Wu and Hausman (Hausman 1978, Econometrica 46:1251): what the
instruments do not predict of the regressor is added as a regressor of its own; if that one matters, the regressor is
not exogenous.

Instruments are the setpoints with their derivatives, or, in a log without setpoints, voltages and positions older than
the correlation time of the noise.
"""

import numpy as np
from scipy.special import chdtrc

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.result import FeedbackBias
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.screening.search import Fit
from puma_sim_core.identify.settings import CHECKS


def instruments(problem: Problem, joint: int) -> tuple[Floats, str]:
    """(m, k) instruments of one joint at the kept rows, and what they are."""
    s = problem.sampled
    if s.setpoint is not None and np.ptp(s.setpoint[:, joint]) > 0.0:
        source, first, name = s.setpoint[:, [joint]], 0.0, "setpoints"
    else:
        source = np.column_stack([s.voltage[:, joint], s.position[:, joint]])
        first, name = CHECKS.feedback_forgotten, "voltages and positions older than the noise"
    shifts = [int(round((first + age) / s.step)) for age in CHECKS.feedback_ages]
    logs = []
    for rows in s.stretches:
        derivatives = filters.low_pass(source[rows], s.step, s.cutoffs[1], (0, 1, 2, 3))
        late = [
            np.vstack([np.repeat(d[:1], shift, axis=0), d[: len(d) - shift]]) for shift in shifts for d in derivatives
        ]
        logs.append(np.hstack(late))
    Z = np.vstack(logs)[problem.kept]
    Z = Z - Z.mean(axis=0)
    size = np.linalg.norm(Z, axis=0)
    Z = Z[:, size > 0.0] / size[size > 0.0]
    # directions that differ by rounding only are no instruments
    U, values, _ = np.linalg.svd(Z, full_matrices=False)
    return U[:, values > 1e-6 * values[0]], name


def test(problem: Problem, fit: Fit) -> FeedbackBias:
    """The test at each joint, for the rate of the commanded voltage. fit : the model with all that was found in it."""
    s = problem.sampled
    rate = s.second(s.voltage, order=1)[problem.kept]
    statistic = np.zeros(s.joints)
    name = ""
    for j, (whitener, N, e) in enumerate(zip(fit.base.whiteners, fit.base.N, fit.base.innovations())):
        Z, name = instruments(problem, j)
        x, Zw = whitener(rate[:, j]), whitener(Z)
        unexplained = x - Zw @ np.linalg.lstsq(Zw, x, rcond=None)[0]
        X = np.column_stack([x, unexplained])
        size = np.linalg.norm(X, axis=0)
        if not (size > 1e-9 * np.sqrt(len(x))).all():
            continue
        X = X / size
        # the parameters that the fit moved take part in both regressions
        inner = np.eye(N.shape[1]) + N.T @ N
        project = X - N @ np.linalg.solve(inner, N.T @ X)
        G = X.T @ project
        if np.linalg.cond(G) > 1e8:
            continue
        b = np.linalg.solve(G, project.T @ e)
        covariance = np.linalg.inv(G) * max(1.0, float((e**2).mean()))
        statistic[j] = b[1] ** 2 / covariance[1, 1]
    p_value = chdtrc(1, statistic)
    joints = ", ".join(str(j + 1) for j in np.flatnonzero(p_value < CHECKS.feedback_significance))
    sentence = (
        f"Feedback shows in the voltage of joint {joints}: a delay or an elasticity found here may come from it; "
        "a dither on the voltage would tell."
        if joints
        else "No sign that feedback biases a delay or an elasticity."
    )
    return FeedbackBias(statistic, p_value, bool(joints), name, sentence)
