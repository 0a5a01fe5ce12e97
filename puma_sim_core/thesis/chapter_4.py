# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Sections 4.3 to 4.5: the coefficients in symbols, their parameters, and their numbers."""

from dataclasses import replace
from math import pi, radians

import numpy as np

from puma_sim_core.arm.arm import ArmParameters, Link
from puma_sim_core.arm.parameters import load_parameters, parameter_sets, smallest_eigenvalue
from puma_sim_core.arm.printed_coefficients import coefficient
from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia, lumped_constants
from puma_sim_core.thesis.misprints import chapter_4_forms as forms
from puma_sim_core.thesis.misprints.chapter_4_forms import UNITS, coefficient_terms, is_misprint, printed_terms, value
from puma_sim_core.thesis.motions import HORIZONTAL, UPRIGHT, angles
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.thesis.wording import Words

words = Words(__name__)
EQUATIONS = words.table("EQUATIONS")
#: a pose at which no sine or cosine is nought, so that no misprint hides
POSE = (0.0, radians(-40.0), radians(70.0))


def corrected_value(name: str, q, arm: ArmParameters) -> float:
    """One entry of D, C or G by the closed form, motor inertias apart; q: (3,) [rad]."""
    index = tuple(int(digit) - 1 for digit in name[1:])
    source = {"D": inertia, "C": coriolis, "G": gravity_torque}[name[0]]
    return float(source(np.asarray(q, dtype=float), arm)[index])


def printed_value(name: str, slips, q, arm: ArmParameters) -> float:
    """One equation of section 4.3 with its misprints, at an arm and a pose."""
    # C311 has another one's right-hand side
    return forms.evaluate(name, forms.symbols(q, arm), () if name == "C311" else slips)


def _poses(arm: ArmParameters) -> np.ndarray:
    q2, q3 = np.meshgrid(*(np.linspace(low, high, 25) for low, high in arm.joint_ranges[1:]))
    return angles(q2.ravel(), q3.ravel())


@words.experiment("4.3")
def equations(context: Context) -> Result:
    """Every equation of section 4.3 as printed, at the set behind the thesis's numbers."""
    arm = load_parameters("bejczy")
    rows = []
    for index, (name, number, slips, slip) in enumerate(EQUATIONS):
        at = [(corrected_value(name, q, arm), printed_value(name, slips, q, arm)) for q in (POSE, *_poses(arm))]
        (exact, *ours), (printed, *others) = zip(*at)
        what = {"name": name, "number": number, "unit": UNITS[name[0]], "printed": printed, "slip": slip}
        sizes = {"off": np.abs(np.subtract(others, ours)).max(), "reach": np.abs(ours).max()}
        rows.append(words.row("equation", exact, case=bool(slip), **what, **sizes))
        context.progress((index + 1) / len(EQUATIONS))
    wrong = [name for name, *_, slip in EQUATIONS if slip]
    count = {"count": len(EQUATIONS), "wrong": len(wrong), "right": len(EQUATIONS) - len(wrong)}
    return words.result("4.3", rows, (), {"wrong_as_printed": wrong}, **count)


@words.experiment("4.4")
def parameters(context: Context) -> Result:
    """The published sets beside one another, and whether each can be an arm."""
    arms = {name: load_parameters(name) for name in parameter_sets()}
    worst, radii = (_greatest_difference(arms["bejczy"], arms["armstrong"], centres) for centres in (True, False))
    rows = [words.row("difference", 100.0 * worst[0], worst=worst[1], percent=100.0 * radii[0], radii=radii[1])]
    for index, (name, arm) in enumerate(arms.items()):
        lowest, *at = smallest_eigenvalue(arm)
        alone = np.linalg.eigvalsh(inertia(_poses(arm), arm))[:, 0].min()
        proof = words.text("alone", case=alone < 0)
        rows.append(words.row("eigenvalue", lowest, case=name, name=name, at=np.degrees(at), alone=alone, proof=proof))
        context.progress((index + 1) / (len(arms) + 1))
    for name, arm in arms.items():
        upright, flat = (inertia(np.array(q), arm)[0, 0] + arm.motor_inertia[0] for q in (UPRIGHT, HORIZONTAL))
        rows.append(words.row("inertia", name=name, upright=upright, flat=flat))
    torques = {name: np.abs(gravity_torque(_poses(arm), arm)).max(axis=0) for name, arm in arms.items()}
    rows += [words.row("gravity", name=name, torque=torque) for name, torque in torques.items()]
    rows.append(_tuned_row(arms["tuned"]))
    q2 = np.linspace(*arms["bejczy"].joint_ranges[1], 181)
    swing = angles(q2, pi / 2)

    def curves(quantity):
        return [Curve(name, np.degrees(q2), quantity(arm)) for name, arm in arms.items()]

    figures = [
        words.figure("4.4-inertia", curves(lambda arm: inertia(swing, arm)[:, 0, 0] + arm.motor_inertia[0])),
        words.figure("4.4-gravity", curves(lambda arm: gravity_torque(swing, arm)[:, 1])),
    ]
    context.progress(1.0)
    masses = {f"mass_kg_{name}": [link.mass for link in arm.links] for name, arm in arms.items()}
    percent = {"worst": 100.0 * worst[0], "radii": 100.0 * radii[0]}
    return words.result("4.4", rows, figures, masses, count=len(arms), **percent)


def _greatest_difference(one: ArmParameters, two: ArmParameters, centres: bool = True) -> tuple[float, str]:
    def values(arm: ArmParameters) -> dict[str, float]:
        s = vars(forms.symbols(POSE, arm))
        return {name: s[name] for name in s if name[0] in ("mkxyz" if centres else "mk")}

    pairs = [(name, u, values(two)[name]) for name, u in values(one).items() if u]
    return max((abs(v - u) / abs(u), name) for name, u, v in pairs)


def _tuned_row(tuned: ArmParameters) -> Row:
    """Table 7.1 taken at its word."""
    table = words.table("TABLE_7_1")
    links = [
        replace(link, mass=row["mass"], gyration_squared=tuple(row["gyration_squared"]))
        for link, row in zip(tuned.links, table)
    ]
    motors = [replace(motor, inertia=row["motor_inertia"]) for motor, row in zip(tuned.motors, table)]
    lowest, *at = smallest_eigenvalue(replace(tuned, links=tuple(links), motors=tuple(motors)))
    return words.row("tuned", lowest, at=np.degrees(at))


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
    terms, motors = coefficient_terms(arm), words.table("MOTORS")
    rows = []
    for name, basis, printed, half in printed_terms():
        ours = terms[name].get(basis, 0.0)
        if basis == "1" and name in motors:
            # the print has the motor inertia as a number of its own
            joint, motor = int(name[1]), motors[name]
            held = arm.motors[joint - 1].inertia
            rows.append(words.row("motor", held, name=name, joint=joint, printed=motor))
            printed, ours = round(printed - motor, 4), ours - held
        off, wrong = abs(printed - ours), is_misprint(name, basis)
        case = f"{name} {basis}" if wrong else "rounded" if off > 2.0 * half else "fits"
        what = {"name": name, "function": "constant" if basis == "1" else basis, "unit": UNITS[name[0]], "off": off}
        what |= {"printed": printed or "no such term", "agrees": not wrong and off <= 4.0 * half}
        rows.append(words.row("term", ours or "no such term", case=case, **what))
    return rows


def _recovered_rows(arm: ArmParameters) -> list[Row]:
    """Lengths and gravity from the printed numbers and the masses of row 3*."""
    m3, (x3, _, z3) = arm.links[2].mass, arm.links[2].centre
    g = 10.4068 / (m3 * z3)
    found = {
        "g, from G3 (S23)": ("m/s^2", g, arm.gravity),
        "a2, from D22 (S3)": ("m", 0.9161 / (2 * m3 * z3), arm.a2),
        "a3, from G3 (C23)": ("m", -0.3761 / (m3 * g) - x3, arm.a3),
        "d3, from D13 (C23)": ("m", 0.1596 / (m3 * z3), arm.d3),
    }
    return [
        words.row("recovered", ours, name=name, unit=unit, found=round(value, 4))
        for name, (unit, value, ours) in found.items()
    ]


def _misprint_figure(name: str, arm: ArmParameters) -> Figure:
    over = np.radians(np.linspace(-52.0, 232.0, 200) if name == "D22" else np.linspace(-223.0, 43.0, 200))
    q = angles(0.0, over) if name == "D22" else angles(over, pi / 2)
    curves = [
        Curve("corrected", np.degrees(over), value(coefficient_terms(arm)[name], q)),
        Curve("printed", np.degrees(over), coefficient(name, q), "dashed"),
    ]
    return words.figure("misprint", curves, case=name, name=name, unit=UNITS[name[0]])


@words.experiment("4.5")
def numbers(context: Context) -> Result:
    """Each printed number beside ours, and the numbers held against every parameter set."""
    arm = load_parameters("bejczy")
    terms = _term_rows(arm)
    context.progress(0.3)
    matched, curves, by_set = [], [], {}
    for name, other in _hypotheses().items():
        held = _held_against(other)
        off = np.array([abs(printed - ours) for _, _, printed, ours, _ in held])
        hits = by_set[name] = sum(each <= tolerance for each, (*_, tolerance) in zip(off.tolist(), held))
        why, worst = words.text("set", case=name), held[int(off.argmax())]
        matched.append(words.row("matched", case=name, name=name, hits=hits, count=len(held), why=why, worst=worst))
        if name in ("bejczy", "average", "armstrong", "paul"):
            curves.append(Curve(name, np.arange(1, len(off) + 1), np.maximum(off, 1e-6), "points"))
    context.progress(1.0)
    figures = [
        words.figure("4.5-sets", curves),
        *(_misprint_figure(name, arm) for name in ("D11", "D22", "C112", "C113", "C122")),
    ]
    values = {
        "matched": by_set,
        "coefficients": {name: coefficient_terms(other) for name, other in _hypotheses().items()},
        "lumped_constants_bejczy": dict(lumped_constants(arm)._asdict()),
    }
    slips = sum(is_misprint(name, basis) for name, basis, *_ in printed_terms())
    rows = [*matched, *_recovered_rows(arm), *terms]
    return words.result("4.5", rows, figures, values, count=len(_held_against(arm)), hits=by_set, slips=slips)
