# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Sections 4.3 to 4.5: the coefficients in symbols, their parameters, and their numbers."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians

import numpy as np

from puma_sim_core.arm.arm import ArmParameters, Link
from puma_sim_core.arm.parameters import load_parameters, parameter_sets, smallest_eigenvalue
from puma_sim_core.arm.printed_coefficients import coefficient
from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia, lumped_constants
from puma_sim_core.thesis.misprints import chapter_4_forms as forms
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.thesis.terms import UNITS, coefficient_terms, is_misprint, printed_terms, value

#: a pose at which no sine or cosine is nought, so that no misprint hides
POSE = (0.0, radians(-40.0), radians(70.0))
HORIZONTAL = (0.0, 0.0, pi / 2)
UPRIGHT = (0.0, -pi / 2, pi / 2)

#: coefficient, equation, slips of its print (as misprints.chapter_4_forms names them), in words
EQUATIONS = (
    ("D11", "4.9", ("k1zz", "d3", "no y2"), "k1zz for k1yy, d3 for d3^2, and -2 m2 a2 y2 S2 C2 is missing"),
    ("D12", "4.10", (), ""),
    ("D13", "4.11", (), ""),
    ("D22", "4.13", ("a2", "a3", "k3zz"), "a2 for a2^2, a3 for a3^2, k3zz for k3yy"),
    ("D23", "4.14", ("k3zz",), "k3zz for k3yy"),
    ("D33", "4.17", ("k3zz",), "k3zz for k3yy"),
    (
        "C112",
        "4.19",
        ("a2", "S2C3", "no k3zz", "a2a3S23", "2a3", "C2S3"),
        "a2 for a2^2, 2 a3 for 2 a3^2, three wrong sines, and the factor k3zz is missing",
    ),
    ("C113", "4.20", ("k3yy", "2a3"), "k3yy for k3zz, 2 a3 for 2 a3^2"),
    ("C122", "4.22", ("no y3 + d3",), "labelled C112, and m3 a2 (y3 + d3) C2 is missing"),
    ("C123", "4.23", (), ""),
    ("C133", "4.26", (), ""),
    ("C223", "4.32", ("S2",), "S2 for S3"),
    ("C233", "4.35", (), ""),
    ("C311", "4.36", ("C133",), "-C133 for -C113"),
    ("G2", "4.46", ("y3",), "y3 for y2"),
    ("G3", "4.47", (), ""),
)


def corrected_value(name: str, q, arm: ArmParameters) -> float:
    """One entry of D, C or G by the closed form, motor inertias apart; q: (3,) [rad]."""
    index = tuple(int(digit) - 1 for digit in name[1:])
    source = {"D": inertia, "C": coriolis, "G": gravity_torque}[name[0]]
    return float(source(np.asarray(q, dtype=float), arm)[index])


def printed_value(name: str, slips, q, arm: ArmParameters) -> float:
    """One equation of section 4.3 with its misprints, at an arm and a pose."""
    s = forms.symbols(q, arm)
    if name == "C311":
        return -forms.c123(s)
    if name == "C133":
        return forms.c123(s)
    if name == "C233":
        return forms.c223(s)
    if name == "D13":
        return _d13(s)
    if name == "D12":
        return s.m2 * s.a2 * s.z2 * s.s2 + s.m3 * (s.a2 * s.y3 + s.a2 * s.d3) * s.s2 + _d13(s)
    if name == "G3":
        return -s.m3 * s.g * (s.x3 * s.cu + s.z3 * s.su + s.a3 * s.cu)
    return float(getattr(forms, name.lower())(s, frozenset(slips)))


def _d13(s) -> float:
    return s.m3 * ((s.x3 * s.d3 + s.a3 * s.y3 + s.a3 * s.d3) * s.su - s.z3 * s.d3 * s.cu)


def _poses(arm: ArmParameters) -> np.ndarray:
    (low2, high2), (low3, high3) = arm.joint_ranges[1:]
    q2, q3 = np.meshgrid(np.linspace(low2, high2, 25), np.linspace(low3, high3, 25))
    return np.stack([np.zeros(q2.size), q2.ravel(), q3.ravel()], axis=-1)


@experiment("4.3", "The coefficients of the equations of motion in symbols", chapter="4.3")
def equations(context: Context) -> Result:
    """Every equation of section 4.3 as printed, at the set behind the thesis's numbers."""
    arm = load_parameters("bejczy")
    poses = _poses(arm)
    rows, wrong = [], []
    for index, (name, number, slips, words) in enumerate(EQUATIONS):
        ours = [corrected_value(name, q, arm) for q in poses]
        printed = [printed_value(name, slips, q, arm) for q in poses]
        off = float(np.max(np.abs(np.subtract(printed, ours))))
        if words:
            wrong.append(name)
        rows.append(
            Row(
                f"{name}, equation {number}",
                UNITS[name[0]],
                printed_value(name, slips, POSE, arm),
                corrected_value(name, POSE, arm),
                f"Printed: {words}. Wrong by up to {off:.3g} {UNITS[name[0]]} over the joint ranges, "
                f"where the coefficient reaches {np.max(np.abs(ours)):.3g}."
                if words
                else "",
            )
        )
        context.progress((index + 1) / len(EQUATIONS))
    return Result(
        f"Of the {len(EQUATIONS)} equations with symbols, {len(wrong)} are wrong as printed and "
        f"{len(EQUATIONS) - len(wrong)} are right. The table evaluates each at q2 = -40 deg, "
        "q3 = 70 deg with the parameters behind the thesis's numbers, motor inertias apart. The "
        "corrected equations agree with an independent derivation to rounding; the errata at the "
        "end prove each slip alone.",
        tuple(rows),
        (),
        {"wrong_as_printed": wrong},
    )


@experiment("4.4", "The parameters of the links", chapter="4.4")
def parameters(context: Context) -> Result:
    """The published sets beside one another, and whether each can be an arm."""
    arms = {name: load_parameters(name) for name in parameter_sets()}
    rows = []
    worst = _greatest_difference(arms["bejczy"], arms["armstrong"])
    radii = _greatest_difference(arms["bejczy"], arms["armstrong"], centres=False)
    rows.append(
        Row(
            "greatest difference between Bejczy and Armstrong, rows 1, 2 and 3*",
            "%",
            12.0,
            100.0 * worst[0],
            f"It is that of {worst[1]}. Masses and the radii of gyration squared differ by "
            f"up to {100.0 * radii[0]:.1f} % ({radii[1]}).",
        )
    )
    for index, (name, arm) in enumerate(arms.items()):
        with_motors, q2, q3 = smallest_eigenvalue(arm)
        alone = float(np.linalg.eigvalsh(inertia(_poses(arm), arm))[:, 0].min())
        rows.append(
            Row(
                f"smallest eigenvalue of D + Ia, {name}",
                "kg.m^2",
                "positive (6.3)" if name != "corke_armstrong_1994" else None,
                with_motors,
                f"At q2 = {np.degrees(q2):.0f}, q3 = {np.degrees(q3):.0f} deg. Without motor inertias "
                f"{alone:.3f}: "
                + (
                    "D alone is not positive definite, so that the proof in 6.3 does "
                    "not hold; the motors make the arm possible."
                    if alone < 0
                    else "positive definite alone."
                ),
            )
        )
        context.progress((index + 1) / (len(arms) + 1))
    for name, arm in arms.items():
        upright, flat = (np.diag(inertia(np.array(q), arm)) + arm.motor_inertia for q in (UPRIGHT, HORIZONTAL))
        rows.append(
            Row(
                f"inertia of joint 1, arm upright and stretched out, {name}",
                "kg.m^2",
                None,
                f"{upright[0]:.4f} and {flat[0]:.4f}",
            )
        )
    for name, arm in arms.items():
        torque = np.abs(gravity_torque(_poses(arm), arm)).max(axis=0)
        rows.append(
            Row(
                f"greatest gravity torque of joints 2 and 3, {name}",
                "N.m",
                None,
                f"{torque[1]:.2f} and {torque[2]:.2f}",
            )
        )
    rows.append(_tuned_row(arms["tuned"]))
    q2 = np.linspace(*arms["bejczy"].joint_ranges[1], 181)
    swing = np.stack([np.zeros_like(q2), q2, np.full_like(q2, pi / 2)], axis=-1)
    figures = (
        Figure(
            "4.4-inertia",
            "Inertia of joint 1 with its motor, arm stretched",
            "q2 [deg], q3 = 90 deg",
            "D11 + Ia1 [kg.m^2]",
            tuple(
                Curve(name, np.degrees(q2), inertia(swing, arm)[:, 0, 0] + arm.motor_inertia[0])
                for name, arm in arms.items()
            ),
            "Paul takes the mass as spread evenly over the surface of each link.",
        ),
        Figure(
            "4.4-gravity",
            "Gravity torque of joint 2, arm stretched",
            "q2 [deg], q3 = 90 deg",
            "G2 [N.m]",
            tuple(Curve(name, np.degrees(q2), gravity_torque(swing, arm)[:, 1]) for name, arm in arms.items()),
        ),
    )
    context.progress(1.0)
    return Result(
        f"All {len(arms)} sets of parameters give a D + Ia that is positive definite. Bejczy and "
        "Armstrong agree less well than the thesis says: a centre of mass of link 3 differs by "
        f"{100.0 * worst[0]:.0f} %, masses and radii of gyration by {100.0 * radii[0]:.0f} % at "
        "most. Links without products of inertia are not quite possible bodies: D alone is "
        "indefinite for some sets, and only the motor inertias make the arm sound. Table 7.1 "
        "(tuned) cannot be used as printed and stands here in a reading that fits the text.",
        tuple(rows),
        figures,
        {f"mass_kg_{name}": [link.mass for link in arm.links] for name, arm in arms.items()},
    )


def _greatest_difference(one: ArmParameters, two: ArmParameters, centres: bool = True) -> tuple[float, str]:
    found = [(0.0, "")]
    for number, (a, b) in enumerate(zip(one.links, two.links), start=1):
        pairs = [(f"m{number}", a.mass, b.mass)]
        pairs += [(f"k{number}{2 * axis}", u, v) for axis, u, v in zip("xyz", a.gyration_squared, b.gyration_squared)]
        if centres:
            pairs += [(f"{axis}{number}", u, v) for axis, u, v in zip("xyz", a.centre, b.centre)]
        found += [(abs(v - u) / abs(u), name) for name, u, v in pairs if u]
    return max(found)


def _tuned_row(tuned: ArmParameters) -> Row:
    """Table 7.1 taken at its word: smallest eigenvalue of D + Ia."""
    radii = ((0.1802, 0.1800, 0.0141), (-0.0516, 0.1900, 0.0031), (0.0510, 0.0691, 0.0027))
    taken = replace(
        tuned,
        links=tuple(
            replace(link, mass=mass, gyration_squared=k)
            for link, mass, k in zip(tuned.links, (12.96, 22.37, 5.01), radii)
        ),
        motors=tuple(
            replace(motor, inertia=inertia_) for motor, inertia_ in zip(tuned.motors, (0.1816, 0.2361, 0.0590))
        ),
    )
    lowest, q2, q3 = smallest_eigenvalue(taken)
    return Row(
        "smallest eigenvalue of D + Ia, table 7.1 as printed",
        "kg.m^2",
        "positive (6.3)",
        lowest,
        f"At q2 = {np.degrees(q2):.0f}, q3 = {np.degrees(q3):.0f} deg. A negative radius "
        "squared (-0.0516), k2zz = 0.0031, motor inertias that are a tenth of table 4.2's "
        "(that of joint 1 is k1xx again) and the mass of row 3 beside radii of row 3* "
        "cannot belong to an arm.",
    )


def _hypotheses() -> dict[str, ArmParameters]:
    """Sets that might have made the numbers of section 4.5."""
    arms = {name: load_parameters(name) for name in parameter_sets()}
    bejczy = arms["bejczy"]
    plain3 = Link(5.01, (0.0204, 0.0137, 0.0037), (0.0151, 0.0155, 0.0021))
    arms["bejczy, row 3 without the wrist"] = replace(bejczy, links=(*bejczy.links[:2], plain3))
    arms["bejczy, a3 = +0.0191 m"] = replace(bejczy, a3=-bejczy.a3)
    return arms


def _held_against(arm: ArmParameters) -> list[tuple[str, str, float, float, float]]:
    """(coefficient, function, printed, from the arm, tolerance) for prints without a slip."""
    terms = coefficient_terms(arm)
    # two half units: one for the print, one for the digits of the tables behind it
    return [
        (name, basis, printed, terms[name].get(basis, 0.0), 2.0 * half)
        for name, basis, printed, half in printed_terms()
        if not is_misprint(name, basis)
    ]


def _term_rows(arm: ArmParameters) -> list[Row]:
    terms = coefficient_terms(arm)
    rows = []
    for name, basis, printed, half in printed_terms():
        ours = terms[name].get(basis, 0.0)
        if basis == "1" and name in _MOTORS:
            # the print has the motor inertia as a number of its own
            joint = int(name[1])
            motor, held = _MOTORS[name], arm.motors[joint - 1].inertia
            rows.append(Row(f"{name}: motor inertia Ia{joint}", "kg.m^2", motor, held))
            printed, ours = round(printed - motor, 4), ours - held
        note, agrees = "", abs(printed - ours) <= 4.0 * half
        if is_misprint(name, basis):
            note, agrees = _WHY[name, basis], False
        elif abs(printed - ours) > 2.0 * half:
            note = f"Off by {abs(printed - ours):.4f}, a rounding in the thesis."
        rows.append(
            Row(
                f"{name}: {'constant' if basis == '1' else basis}",
                UNITS[name[0]],
                printed or "no such term",
                ours or "no such term",
                note,
                agrees,
            )
        )
    return rows


#: motor inertias as section 4.5.1 prints them [kg.m^2]
_MOTORS = {"D11": 0.7766, "D22": 2.3616, "D33": 0.5827}


_WHY = {
    ("D11", "C2"): "Printed C2 without its square.",
    ("D11", "C2^2"): "Printed C2 without its square.",
    ("D11", "C2S2"): "Left out here and in equation 4.9, and yet its derivative stands in C112.",
    ("D22", "1"): "The term 2 m3 a3 x3 was taken with a3 = +0.0191 m: that gives 3.0574 exactly.",
    ("C112", "C2C23"): "A digit slipped: 0.4581, as in C113.",
    ("C112", "C23"): "Printed C23 without its square.",
    ("C112", "C23^2"): "Printed C23 without its square.",
    ("C113", "S3"): "Copied from C112; equation 4.20 has no such term.",
    ("C122", "C2"): "m3 a2 (y3 + d3) = 0.4806 is missing, as in equation 4.22; D12, of which this "
    "is the derivative, has it.",
}


def _recovered_rows(arm: ArmParameters) -> list[Row]:
    """Lengths and gravity from the printed numbers and the masses of row 3*."""
    m3, (x3, _, z3) = arm.links[2].mass, arm.links[2].centre
    g = 10.4068 / (m3 * z3)
    rows = (
        ("g, from G3 (S23)", "m/s^2", g, arm.gravity),
        ("a2, from D22 (S3)", "m", 0.9161 / (2 * m3 * z3), arm.a2),
        ("a3, from G3 (C23)", "m", -0.3761 / (m3 * g) - x3, arm.a3),
        ("d3, from D13 (C23)", "m", 0.1596 / (m3 * z3), arm.d3),
    )
    return [
        Row(
            f"length or gravity behind the numbers: {name}",
            unit,
            float(f"{found:.4f}"),
            ours,
            "Solved from the printed number; table 2.1, which had the lengths, is not in the text.",
        )
        for name, unit, found, ours in rows
    ]


def _misprint_figures(arm: ArmParameters) -> list[Figure]:
    sweep = np.radians(np.linspace(-223.0, 43.0, 200))
    elbow = np.radians(np.linspace(-52.0, 232.0, 200))
    terms = coefficient_terms(arm)
    figures = []
    for name in ("D11", "D22", "C112", "C113", "C122"):
        over = elbow if name == "D22" else sweep
        q = np.stack(
            [np.zeros_like(over)]
            + ([np.zeros_like(over), over] if name == "D22" else [over, np.full_like(over, pi / 2)]),
            axis=-1,
        )
        figures.append(
            Figure(
                f"4.5-{name}",
                f"{name} with the printed and with the corrected numbers",
                "q3 [deg]" if name == "D22" else "q2 [deg], q3 = 90 deg",
                f"{name} [{UNITS[name[0]]}]",
                (
                    Curve("corrected", np.degrees(over), value(terms[name], q)),
                    Curve("as printed in section 4.5", np.degrees(over), coefficient(name, q), "dashed"),
                ),
            )
        )
    return figures


@experiment("4.5", "The numbers of the coefficients, and which parameters made them", chapter="4.5")
def numbers(context: Context) -> Result:
    """Each printed number beside ours, and the numbers held against every parameter set."""
    arm = load_parameters("bejczy")
    rows = _term_rows(arm)
    context.progress(0.3)
    matched, curves, by_set = [], [], {}
    for name, other in _hypotheses().items():
        held = _held_against(other)
        off = np.array([abs(printed - ours) for _, _, printed, ours, _ in held])
        hits = int(sum(each <= tolerance for each, (*_, tolerance) in zip(off, held)))
        by_set[name] = hits
        worst = held[int(off.argmax())]
        note = (
            "The set that made the numbers: nothing else comes near."
            if name == "bejczy"
            else "Not the set, although the text says so."
            if name == "average"
            else "The same arm with the sign of a3 changed; only 3.0574 in D22 was made so."
            if "a3" in name
            else "Not the set: it has Bejczy's masses and centres of mass, with other radii."
            if name == "tuned"
            else "Not the set."
        )
        matched.append(
            Row(
                f"printed numbers that follow from {name}",
                "",
                f"all {len(held)}" if name == "average" else None,
                f"{hits} of {len(held)}",
                f"{note} Worst: {worst[0]} ({worst[1]}), printed {worst[2]:g}, from the set {worst[3]:.4f}.",
            )
        )
        if name in ("bejczy", "average", "armstrong", "paul"):
            curves.append(Curve(name, np.arange(1, len(off) + 1), np.maximum(off, 1e-6), "points"))
    context.progress(0.7)
    rows = [*matched, *_recovered_rows(arm), *rows]
    sets = Figure(
        "4.5-sets",
        "Printed numbers against those of four parameter sets",
        "number in section 4.5, in the order of the print",
        "difference [kg.m^2 or N.m]",
        tuple(curves),
        "The misprints are left out. Only Bejczy's parameters come down to the rounding of four decimals.",
        log_y=True,
    )
    slips = sum(is_misprint(name, basis) for name, basis, *_ in printed_terms())
    context.progress(1.0)
    return Result(
        f"The printed numbers are those of Bejczy's parameters (table 4.2, rows 1, 2 and 3*), not "
        f"of the average that the text announces. Of {len(_held_against(arm))} numbers "
        f"{by_set['bejczy']} follow from them within their rounding, from the average "
        f"{by_set['average']}. Besides, {slips} places in five coefficients (D11, D22, C112, C113, "
        "C122) are misprints that no parameters can give. The lengths and gravity that the text "
        "lacks follow from the numbers: a2 = 0.4318, a3 = -0.0191, d3 = 0.1505 m, 9.81 m/s^2.",
        tuple(rows),
        (sets, *_misprint_figures(arm)),
        {
            "matched": by_set,
            "coefficients": {name: coefficient_terms(other) for name, other in _hypotheses().items()},
            "lumped_constants_bejczy": dict(lumped_constants(arm)._asdict()),
        },
    )
