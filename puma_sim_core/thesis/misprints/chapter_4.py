# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Proofs of the misprints of chapter 4: the coefficients of the arm in symbols and in numbers."""

from dataclasses import replace

import numpy as np

from puma_sim_core.arm import printed_coefficients as section_4_5
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import lumped_constants
from puma_sim_core.thesis.misprints import chapter_4_forms as forms
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.evidence import read_errata
from puma_sim_core.thesis.misprints.reference import POSES, RATES, at_poses, nominal, over


def entry(name, arm=None):
    """The independent value of D22, C113, -C112, G2 ... as a function of the pose."""
    sign, name = (-1, name[1:]) if name[0] == "-" else (1, name)
    source = {"D": reference.inertia, "C": reference.coriolis, "G": reference.gravity}[name[0]]
    return lambda q: sign * source(q, arm)[tuple(int(digit) - 1 for digit in name[1:])]


def prove_equation(name, slip="", label=None):
    def form(q, *slips):
        return forms.evaluate(name, forms.symbols(q, nominal()), slips)

    return at_poses(entry(name), form, entry(label) if label else lambda q: form(q, slip))


def prove_another_coefficient(name, correct, printed):
    return at_poses(entry(name), entry(correct), entry(printed))


def prove_second_row():
    def p(q, qd, _, second=1):
        c = reference.coriolis(q)
        return np.array([qd @ c[i] @ qd for i in (0, second, 2)]) + reference.gravity(q)

    states = [(q, qd, np.zeros(3)) for q, qd in zip(POSES, RATES)]
    return over(states, reference.torque, p, lambda *state: p(*state, second=0))


def prove_shape_of_p(correct, printed):
    return reference.torque(POSES[0], RATES[0], np.zeros(3))[:, None].shape, correct, printed


def prove_equations_for_d31(correct, printed):
    # the rank of a line with these coefficients of (D13, D31)
    needed = int(abs(entry("D31")(POSES[0]) - entry("D13")(POSES[0])) < 1e-12)
    return needed, *(int(np.linalg.matrix_rank([line])) for line in (correct, printed))


def fitted(name):
    """Coefficients of section 4.5's functions in the independent D, C or G."""
    functions = [term.basis for term in section_4_5.COEFFICIENTS[name]]
    columns = np.column_stack([forms.value({function: 1.0}, POSES) for function in functions])
    (values,) = at_poses(entry(name))
    if name in ("D11", "D22", "D33"):
        values = values + nominal().motor_inertia[int(name[1]) - 1]
    return dict(zip(functions, np.linalg.lstsq(columns, values, rcond=None)[0]))


def prove_number(name, functions):
    fit, found = fitted(name), [term for term in section_4_5.COEFFICIENTS[name] if term.basis in functions]
    return [fit[term.basis] for term in found], [term.corrected for term in found], [term.printed for term in found]


def d22_constant(a3_of_x3: float) -> float:
    """Constant of D22 [kg.m^2] with this a3 [m] in the term 2 m3 a3 x3 alone."""
    link = nominal().links[2]
    return fitted("D22")["1"] + 2 * link.mass * link.centre[0] * (a3_of_x3 - nominal().a3)


def prove_sign_of_a3(motor, correct, printed):
    return d22_constant(nominal().a3), motor + correct, motor + printed


def prove_label(name, correct, printed):
    return *at_poses(entry(name)), *(section_4_5.coefficient(label, POSES, True) for label in (correct, printed))


def prove_dimension(name, correct, printed):
    # powers of two in the value when a unit is halved
    def scaled(mass=1.0, length=1.0, time=1.0):
        arm = nominal()
        links = [
            replace(
                link,
                mass=link.mass * mass,
                centre=tuple(length * x for x in link.centre),
                gyration_squared=tuple(length**2 * k for k in link.gyration_squared),
            )
            for link in arm.links
        ]
        lengths = {each: getattr(arm, each) * length for each in ("a2", "a3", "d3")}
        return replace(arm, links=tuple(links), gravity=arm.gravity * length / time**2, **lengths)

    values = [entry(name, scaled(**{unit: 2.0}))(POSES[0]) for unit in ("mass", "length", "time")]
    return np.log2(np.divide(values, entry(name)(POSES[0]))), correct, printed


def prove_parameters_used(reference, correct, printed):
    found = (lumped_constants(load_parameters(name)) for name in (correct, printed))
    return reference, *([k.E0, k.E2, k.B3, -k.g2, k.g1] for k in found)


def prove_agreement_of_sets(sets, correct, printed):
    one, two = ([link.centre + link.gyration_squared for link in load_parameters(name).links] for name in sets)
    one, two = np.ravel(one), np.ravel(two)
    return 100 * np.max(np.abs(two - one)[one != 0] / np.abs(one[one != 0])), correct, printed


ROWS = read_errata("errata_chapter_4.yaml", globals())
