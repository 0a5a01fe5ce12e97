# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Misprints of chapter 7: the tuned parameters, PID control, the identified controllers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from puma_sim_core.arm.parameters import load_parameters, smallest_eigenvalue
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.evidence import Between, Erratum, Evidence
from puma_sim_core.thesis.misprints.reference import nominal

_INFINITE = float("inf")
#: gain, integral and derivative time [s] of the vertical joint 1 by table 7.2, servo sample [s]
_KG, _TI, _TD, _H = 90.0, 0.225, 0.05625, 0.028 / 30

# ---------------------------------------------------------------------------------- table 7.1


def _with(link=None, motor=None, **changes):
    """The marked reconstruction of table 7.1 with one number put back as printed."""
    arm = load_parameters("tuned")
    owners = list(arm.links if link else arm.motors)
    index = (link or motor) - 1
    owners[index] = replace(owners[index], **changes)
    return replace(arm, **({"links": tuple(owners)} if link else {"motors": tuple(owners)}))


def _inertia_about_y():
    nominal_k, tuned_k = (load_parameters(name).links[0].gyration_squared[1] for name in ("bejczy", "tuned"))
    return Evidence(
        "k1yy, tuned over nominal",
        "",
        "the text: fractionally too large, scaled down",
        Between(0.9, 1.0),
        tuned_k / nominal_k,
        0.1800 / nominal_k,
    )


def _inertia_about_z():
    nominal_k, tuned_k = (load_parameters(name).links[0].gyration_squared[2] for name in ("bejczy", "tuned"))
    return Evidence(
        "k1zz, tuned over nominal",
        "",
        "k1xx beside it: 0.1802 over 0.1816",
        0.1802 / 0.1816,
        tuned_k / nominal_k,
        0.0141 / nominal_k,
        0.01,
    )


def _negative_square():
    k = load_parameters("tuned").links[1].gyration_squared
    return Evidence("k2xx, a square", "m^2", "squares of lengths", Between(0.0, k[1] + k[2]), k[0], -0.0516)


def _upper_arm_inertia():
    tuned = load_parameters("tuned").links[1].gyration_squared
    return Evidence(
        "smallest eigenvalue of D + Ia",
        "kg.m^2",
        "kinetic energy is positive",
        Between(0.0, _INFINITE),
        smallest_eigenvalue(load_parameters("tuned"))[0],
        smallest_eigenvalue(_with(link=2, gyration_squared=(*tuned[:2], 0.0031)))[0],
    )


def _raised():
    tuned = load_parameters("tuned").links[1].gyration_squared[2]
    return Evidence(
        "k2zz, tuned", "m^2", "section 7.4.2: it was increased from 0.1514", Between(0.1514, _INFINITE), tuned, 0.0031
    )


def _forearm_mass():
    row_3, row_3_wrist = 5.01, 6.97
    return Evidence(
        "mass of row 3*, link 3 with the wrist",
        "kg",
        "table 4.2: the masses of rows 3 to 6 in sum",
        row_3 + 1.18 + 0.62 + 0.16,
        row_3_wrist,
        row_3,
        0.0101,
    )


def _motor_inertia(joint, printed):
    def evidence():
        tuned = load_parameters("tuned").motors[joint - 1].inertia
        return Evidence(
            f"Ia{joint}, tuned over nominal",
            "",
            "the text: motor data stay fixed in all tuning",
            1.0,
            tuned / nominal().motors[joint - 1].inertia,
            printed / nominal().motors[joint - 1].inertia,
            1e-9,
        )

    return evidence


def _friction_unit():
    """Power H qd^2 in watts needs H in N.m.s/rad; a unit with m for rad has another dimension."""
    # exponents of length and time: power, angular velocity squared
    power, speed_squared = np.array([2.0, -3.0]), np.array([0.0, -2.0])
    return Evidence(
        "exponents of m and s in H (beside kg)",
        "",
        "power H qd^2 in watts",
        power - speed_squared,
        [2.0, -1.0],
        [1.0, -1.0],
        1e-12,
    )


# -------------------------------------------------------------------------------------- poses


def _upright():
    def height(q):
        wrist = reference.frames(
            q, np.array([[0.0, -np.pi / 2, 0.0], [nominal().a2, 0.0, 0.0], [nominal().a3, np.pi / 2, nominal().d3]])
        )[-1]
        return float((wrist @ np.array([0.0, 0.0, nominal().d4, 1.0]))[2])

    reach = nominal().a2 + nominal().d4
    return Evidence(
        "height of the wrist above the shoulder, arm upright",
        "m",
        "upper arm and forearm in one line",
        reach,
        height(np.radians([0.0, -90.0, 90.0])),
        height(np.radians([0.0, 90.0, -90.0])),
        1e-12,
    )


def _axis_of_joint_3():
    def slope(index):
        link = nominal().links[2]
        raised = list(link.gyration_squared)
        raised[index] += 1.0
        arm = replace(nominal(), links=(*nominal().links[:2], replace(link, gyration_squared=tuple(raised))))
        return reference.inertia(reference.POSES[0], arm)[2, 2] - reference.inertia(reference.POSES[0])[2, 2]

    return Evidence(
        "derivative of D33 to the estimated k^2",
        "kg",
        "mass that turns about joint 3",
        nominal().links[2].mass,
        slope(1),
        slope(2),
        1e-9,
    )


def _estimated_in_7_4_1():
    def slope(link_number, index):
        link = nominal().links[link_number - 1]
        raised = list(link.gyration_squared)
        raised[index] += 1.0
        links = list(nominal().links)
        links[link_number - 1] = replace(link, gyration_squared=tuple(raised))
        q = reference.POSES[0]
        return (reference.inertia(q, replace(nominal(), links=tuple(links))) - reference.inertia(q))[2, 2]

    return Evidence(
        "derivative of D33 to the named k^2",
        "kg",
        "mass that turns about joint 3",
        nominal().links[2].mass,
        slope(3, 1),
        slope(2, 2),
        1e-9,
    )


# ---------------------------------------------------------------------------------------- PID


def _positional(errors, *, weight=_H / _TI, first=0, last=0):
    """u(k) of equation 7.2; first, last : shift of the limits of the sum."""
    found = []
    for k, e in enumerate(errors):
        before = errors[k - 1] if k else 0.0
        start, stop = first, k + last
        total = sum(errors[i] if i >= 0 else 0.0 for i in range(start, stop))
        found.append(_KG * (e + weight * total + _TD / _H * (e - before)))
    return np.array(found)


def _signal():
    time = _H * np.arange(60)
    return np.exp(-time / 0.02) * np.cos(90 * time)


def _integral_weight():
    """Controller under a constant error, long after the start."""
    count, error = 200, 0.1
    errors = np.full(count, error)
    exact = _KG * error * (1 + _H * (count - 1) / _TI)
    return Evidence(
        "controller output after 0.19 s of a constant error of 0.1 rad",
        "V",
        "integral of equation 7.1",
        exact,
        _positional(errors)[-1],
        _positional(errors, weight=1.0)[-1],
        1e-9,
    )


def _sum_limits():
    # a jump of the error: the continuous integral of the held error by that time
    errors = np.concatenate([np.zeros(2), np.full(8, 0.1)])
    k = np.arange(10)
    held = np.concatenate([[0.0], np.cumsum(errors)[:-1]]) * _H
    exact = _KG * (errors + held / _TI + _TD / _H * np.diff(errors, prepend=0.0))
    return Evidence(
        "controller output after a jump of the error",
        "V",
        "integral of the error held between the samples",
        exact[k],
        _positional(errors)[k],
        _positional(errors, first=-1, last=-1)[k],
        1e-9,
    )


def _recursive(errors, sign):
    q0 = _KG * (1 + _TD / _H)
    q1 = sign * _KG * (1 + 2 * _TD / _H - _H / _TI)
    q2 = _KG * _TD / _H
    u, one, two, found = 0.0, 0.0, 0.0, []
    for e in errors:
        u += q0 * e + q1 * one + q2 * two
        found.append(u)
        one, two = e, one
    return np.array(found)


def _middle_sign():
    errors = _signal()[:12]
    return Evidence(
        "output of the recursive controller",
        "V",
        "the positional form",
        _positional(errors),
        _recursive(errors, -1),
        _recursive(errors, 1),
        1e-7,
    )


# --------------------------------------------------------------------------------- section 7.8


def _integrator(*denominators):
    """Distance of the nearest pole to z = 1, where a PID controller has one."""
    return [float(np.min(np.abs(np.roots(d) - 1.0))) for d in denominators]


def _lost_signs():
    return Evidence(
        "distance of the identified controllers' nearest pole from z = 1",
        "",
        "a PID controller integrates: equation 7.4",
        Between(0.0, 0.2),
        _integrator([1, -0.96, 0.106], [1, -1.13, 0.0972]),
        _integrator([1, 0.96, 0.106], [1, 1.13, 0.0972]),
    )


def _gain_of(q0, q2):
    """Kg by equations 7.5 and 7.7."""
    return q0 - q2


def _coefficients(gain, derivative, sample):
    return gain * (1 + derivative / sample), gain * derivative / sample


def _quoted_gain(quoted, derivative, printed, spread):
    def evidence():
        return Evidence(
            "gain that the identified coefficients give (q0 - q2)",
            "V/rad",
            "the value that section 7.8 quotes, with its interval",
            Between(quoted * (1 - spread), quoted * (1 + spread)),
            _gain_of(*_coefficients(quoted, derivative, 0.00093)),
            _gain_of(*printed),
        )

    return evidence


def _summary_difference():
    """Smallest difference of a parameter, estimated by table 7.2 against identified, upright."""
    estimated = np.array([0.6 * 150, 0.45 / 2, 0.45 / 8])
    identified = np.array([176, 0.42, 0.04])
    difference = np.abs(estimated - identified)
    least = [100 * np.min(difference / base) for base in (estimated, identified)]
    return Evidence(
        "least difference of a PID parameter, upright",
        "%",
        "tables and sections 7.7.1 and 7.8: 150 and 0.45 s against 176, 0.42 s, 0.04 s",
        Between(min(least) - 0.5, _INFINITE),
        28.9,
        17.0,
    )


ROWS = (
    Erratum(
        "7.1 k1yy",
        "table 7.1, row 1, yy",
        "0.1800",
        "0.0141",
        _inertia_about_y,
        "Columns yy and zz of row 1 are exchanged: a frame in which joint 1 turns about z1.",
    ),
    Erratum("7.1 k1zz", "table 7.1, row 1, zz", "0.0141", "0.1800", _inertia_about_z),
    Erratum("7.1 k2xx", "table 7.1, row 2, xx", "-0.0516", "0.0516", _negative_square),
    Erratum(
        "7.1 k2zz",
        "table 7.1, row 2, zz",
        "0.0031",
        "not known; 0.1514 is kept",
        _upper_arm_inertia,
        "With the printed number no motion is possible.",
    ),
    Erratum(
        "7.1 k2zz raised",
        "table 7.1, row 2, zz, and section 7.4.2",
        "0.0031 after an increase",
        "at least the nominal 0.1514",
        _raised,
    ),
    Erratum("7.1 mass", "table 7.1, row 3*, mass", "5.01", "6.97", _forearm_mass, "5.01 kg is the bare link of row 3."),
    Erratum(
        "7.1 Ia1",
        "table 7.1, Ia of joint 1",
        "0.1816",
        "0.7766",
        _motor_inertia(1, 0.1816),
        "0.1816 is k1xx of table 4.2, copied.",
    ),
    Erratum("7.1 Ia2", "table 7.1, Ia of joint 2", "0.2361", "2.3616", _motor_inertia(2, 0.2361), "A factor of ten."),
    Erratum(
        "7.1 Ia3",
        "table 7.1, Ia of joint 3",
        "0.0590",
        "0.5827",
        _motor_inertia(3, 0.0590),
        "A factor of ten, and a digit.",
    ),
    Erratum("7.1 unit", "table 7.1, unit of the friction", "Nm/m/s", "N.m.s/rad", _friction_unit),
    Erratum(
        "7.4.1 axis",
        "section 7.4.1, why k3zz",
        "only the z component, because link 3 turns about z",
        "k3yy: joint 3 turns about y3",
        _axis_of_joint_3,
    ),
    Erratum("7.4.1 k2zz", "section 7.4.1, last sentences", "k2zz", "k3zz (that is, k3yy)", _estimated_in_7_4_1),
    Erratum(
        "7.4.3 pose",
        "section 7.4.3, extended upright",
        "q = (0, 90, -90) deg",
        "q = (0, -90, 90) deg",
        _upright,
        "As printed the upper arm hangs down and the forearm is folded back up.",
    ),
    Erratum("7.2 h/Ti", "equation 7.2, sum", "no factor", "h / Ti", _integral_weight),
    Erratum("7.2 limits", "equation 7.2, sum", "e(i - 1) for i = 0 to k - 1", "e(i - 1) for i = 1 to k", _sum_limits),
    Erratum("7.6 minus", "equation 7.6", "q1 = Kg (1 + 2 Td/h - h/Ti)", "q1 = -Kg (1 + 2 Td/h - h/Ti)", _middle_sign),
    Erratum(
        "7.9 signs",
        "equations 7.9 and 7.10, denominators",
        "+ 0.96, + 1.13",
        "- 0.96, - 1.13",
        _lost_signs,
        "The middle coefficients of the numerators want a minus too (equation 7.6).",
    ),
    Erratum(
        "7.9 gain",
        "equation 7.9 and the gain quoted for it",
        "6739 and 5743 give 996 V/rad",
        "137 V/rad would have q0 - q2 = 137",
        _quoted_gain(137.0, 0.032, (6739.0, 5743.0), 0.13),
        "Which digits are wrong cannot be told: differences of near-equal numbers.",
    ),
    Erratum(
        "7.10 gain",
        "equation 7.10 and the gain quoted for it",
        "8618 and 8913 give -295 V/rad",
        "176 V/rad would have q0 - q2 = 176",
        _quoted_gain(176.0, 0.04, (8618.0, 8913.0), 0.45),
    ),
    Erratum(
        "7.10 differ",
        "summary of chapter 7, estimated against measured PID, upright",
        "17 %",
        "28.9 % at least",
        _summary_difference,
        "Gain, integral and derivative time differ by 49, 46 and 41 % of the identified "
        "values, by 96, 87 and 29 % of the estimated ones.",
    ),
)
