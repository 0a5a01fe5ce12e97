# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Proofs of the misprints of chapter 7: the tuned parameters, PID control, the identified controllers."""

import math
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from puma_sim_core.arm.parameters import load_parameters, smallest_eigenvalue
from puma_sim_core.servo.pid import PidGains, recursive_coefficients
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.evidence import Between, read_errata
from puma_sim_core.thesis.misprints.reference import nominal

# --------------------------------------------------------------------------- table 7.1 and section 7.4


def gyration(link: int, name: str = "tuned"):
    """k^2 about x, y and z of a link (from 1) of a parameter set [m^2]."""
    return load_parameters(name).links[link - 1].gyration_squared


def with_gyration(arm, link: int, gyration_squared):
    """The arm with other k^2 of a link (from 1)."""
    changed = replace(arm.links[link - 1], gyration_squared=tuple(gyration_squared))
    return replace(arm, links=(*arm.links[: link - 1], changed, *arm.links[link:]))


def prove_scale_of_k(axis, reference, printed):
    """k^2 of link 1, tuned over nominal; reference : a range, or the axis whose k^2 is scaled so too."""
    scale = np.divide(gyration(1), gyration(1, "bejczy"))
    expected = reference if isinstance(reference, Between) else scale[reference]
    return expected, scale[axis], printed / gyration(1, "bejczy")[axis]


def prove_motor_inertia(joint, printed):
    tuned, before = (load_parameters(name).motors[joint - 1].inertia for name in ("tuned", "bejczy"))
    return 1.0, tuned / before, printed / before


def prove_square_of_a_length(printed):
    xx, yy, zz = gyration(2)
    return Between(0.0, yy + zz), xx, printed


def prove_possible_upper_arm(reference, printed):
    tuned = load_parameters("tuned")
    put_back = with_gyration(tuned, 2, (*gyration(2)[:2], printed))
    return reference, smallest_eigenvalue(tuned)[0], smallest_eigenvalue(put_back)[0]


def prove_increase(reference, printed):
    return reference, gyration(2)[2], printed


def prove_mass_of_forearm(wrist, correct, printed):
    return printed + sum(wrist), correct, printed


def prove_unit_of_friction(power, speed_squared, correct, printed):
    return np.subtract(power, speed_squared), correct, printed


def prove_mass_about_joint_3(correct, printed):
    def slope(link, axis):
        """Derivative of D33 to k^2 of a link (from 1) about an axis (from 0)."""
        raised = with_gyration(nominal(), link, gyration(link, "bejczy") + np.eye(3)[axis])
        return (reference.inertia(reference.POSES[0], raised) - reference.inertia(reference.POSES[0]))[2, 2]

    return nominal().links[2].mass, slope(*correct), slope(*printed)


def prove_upright(correct, printed):
    arm = nominal()
    table = [[0.0, -np.pi / 2, 0.0], [arm.a2, 0.0, 0.0], [arm.a3, np.pi / 2, arm.d3]]
    wrists = (reference.frames(np.radians(q), table)[-1] @ [0.0, 0.0, arm.d4, 1.0] for q in (correct, printed))
    return arm.a2 + arm.d4, *(wrist[2] for wrist in wrists)


# ----------------------------------------------------------------------------------------- PID control

#: the vertical joint 1 by table 7.2: gain [V/rad], integral and derivative time [s] from Kmax = 150, Tp = 0.45 s
GAINS = PidGains(0.6 * 150, 0.45 / 2, 0.45 / 8)
#: servo sample [s]
SAMPLE = 0.028 / 30


def positional(errors, weight=SAMPLE / GAINS.integral_time, shift=0):
    """u(k) of equation 7.2; weight: of the sum; shift: of both its limits."""
    errors = np.asarray(errors)
    totals = np.array([errors[: max(k + shift, 0)].sum() for k in range(len(errors))])
    slopes = np.diff(errors, prepend=0.0) / SAMPLE
    return GAINS.gain * (errors + weight * totals + GAINS.derivative_time * slopes)


def prove_weight_of_the_sum(error, count):
    exact = GAINS.gain * error * (1 + SAMPLE * (count - 1) / GAINS.integral_time)
    return exact, positional([error] * count)[-1], positional([error] * count, weight=1.0)[-1]


def prove_limits_of_the_sum(error):
    errors = np.array([0.0] * 2 + [error] * 8)
    integral = SAMPLE * (np.cumsum(errors) - errors)
    rate = np.diff(errors, prepend=0.0) / SAMPLE
    exact = GAINS.gain * (errors + integral / GAINS.integral_time + GAINS.derivative_time * rate)
    return exact, positional(errors), positional(errors, shift=-1)


def prove_sign_of_q1():
    time = SAMPLE * np.arange(12)
    errors = np.exp(-time / 0.02) * np.cos(90 * time)
    q = np.array(recursive_coefficients(GAINS, SAMPLE))
    return positional(errors), lfilter(q, [1, -1], errors), lfilter(q * [1, -1, 1], [1, -1], errors)


def prove_poles(reference, correct, printed):
    distances = ([np.min(np.abs(np.roots(each) - 1.0)) for each in denominators] for denominators in (correct, printed))
    return reference, *distances


def prove_gain(quoted, spread, derivative_time, sample, printed):
    # Kg = q0 - q2 by equations 7.5 and 7.7
    q0, _, q2 = recursive_coefficients(PidGains(quoted, math.inf, derivative_time), sample)
    return Between(quoted * (1 - spread), quoted * (1 + spread)), q0 - q2, printed[0] - printed[1]


def prove_least_difference(identified, correct, printed):
    estimated = np.array([GAINS.gain, GAINS.integral_time, GAINS.derivative_time])
    difference = np.abs(estimated - identified)
    least = 100 * min(np.min(difference / estimated), np.min(difference / identified))
    return Between(least - 0.5, math.inf), correct, printed


ROWS = read_errata("errata_chapter_7.yaml", globals())
