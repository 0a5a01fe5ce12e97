# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Every misprint of the thesis is proved: the corrected form holds, the printed one does not.

The references of the rows are derived apart from the forms; the mechanics behind most of them is
held here against MuJoCo and the trace form, neither of which it shares code with.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from test_rigid_body import central_inertia, mujoco_chain, mujoco_terms
from trace_form import arm_table, trace_coriolis, trace_gravity, trace_inertia

from puma_sim_core.arm import printed_coefficients
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import arm_pseudo_inertias
from puma_sim_core.errors import ParameterError
from puma_sim_core.thesis import errata
from puma_sim_core.thesis.errata import ERRATA
from puma_sim_core.thesis.misprints import chapter_4, chapter_4_forms, chapter_5, chapter_6, reference, references
from puma_sim_core.thesis.misprints.evidence import CLEARANCE, Between, Evidence, read_errata
from puma_sim_core.thesis.registry import Context

by_key = pytest.mark.parametrize("erratum", ERRATA, ids=lambda erratum: erratum.key)


@by_key
def test_corrected_form_holds_and_printed_form_does_not(erratum):
    evidence = erratum.evidence()
    assert evidence.correct_error <= evidence.tolerance
    assert evidence.printed_error > CLEARANCE * evidence.tolerance
    assert evidence.printed_error > 0
    assert evidence.proved


@by_key
def test_proof_fails_for_the_printed_form_in_place_of_the_corrected_one(erratum):
    evidence = erratum.evidence()
    assert not replace(evidence, correct=evidence.printed).proved
    assert not replace(evidence, printed=evidence.correct).proved


@by_key
def test_row_says_where_what_and_how_it_was_shown(erratum):
    evidence = erratum.evidence()
    assert erratum.where and erratum.printed != erratum.correct and evidence.by
    sentence = evidence.effect()
    assert sentence.endswith(".") and "nan" not in sentence and evidence.quantity in sentence


def test_keys_are_unique():
    assert len({erratum.key for erratum in ERRATA}) == len(ERRATA)


# --------------------------------------------------------------------- the references themselves


@pytest.mark.parametrize("name", ["bejczy", "paul", "corke_armstrong_1994"])
def test_reference_mechanics_equal_the_trace_form(name):
    arm = load_parameters(name)
    bodies, table = arm_pseudo_inertias(arm), arm_table(arm)
    for q in reference.POSES:
        np.testing.assert_allclose(reference.inertia(q, arm), trace_inertia(q, bodies, table), rtol=0, atol=1e-12)
        np.testing.assert_allclose(reference.coriolis(q, arm), trace_coriolis(q, bodies, table), rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            reference.gravity(q, arm), trace_gravity(q, bodies, table, arm.gravity), rtol=0, atol=1e-12
        )


def test_reference_mechanics_equal_mujoco():
    arm = reference.nominal()
    bodies = [(link.mass, np.array(link.centre), central_inertia(link)) for link in arm.links]
    model, data = mujoco_chain(arm_table(arm), bodies, arm.motor_inertia, arm.gravity)
    for q, qd, qdd in zip(reference.POSES, reference.RATES, reference.ACCELERATIONS):
        mass, bias, _ = mujoco_terms(model, data, q, qd)
        np.testing.assert_allclose(reference.torque(q, qd, qdd, arm), mass @ qdd + bias, rtol=0, atol=1e-11)


def test_torque_rate_is_that_of_a_motion():
    # angles are cubic in time: the rate of the torque along them, by a central difference
    h = 1e-5
    for q, qd, qdd, qddd in chapter_5.states()[:4]:
        ends = [
            chapter_5.joint_torque(
                q + t * qd + t**2 / 2 * qdd + t**3 / 6 * qddd, qd + t * qdd + t**2 / 2 * qddd, qdd + t * qddd
            )
            for t in (h, -h)
        ]
        np.testing.assert_allclose(
            chapter_5.torque_rate(q, qd, qdd, qddd), (ends[0] - ends[1]) / (2 * h), rtol=0, atol=1e-5
        )


def test_jacobian_is_the_slope_of_the_rates():
    state, v = np.linspace(-0.8, 0.9, 9), np.array([20.0, -15.0, 10.0])
    slope = chapter_6.jacobian(state, v)
    for k, unit in enumerate(np.eye(9)):
        difference = (chapter_6.rates(state + 1e-6 * unit, v) - chapter_6.rates(state - 1e-6 * unit, v)) / 2e-6
        np.testing.assert_allclose(slope[:, k], difference, rtol=1e-6, atol=1e-5)


def test_stability_limits_of_the_textbook():
    # on the real axis: 2 for Euler's method, 2.7853 for RK4
    one = np.array([-1000.0])
    assert chapter_6.stability_limit(one, order=1) == pytest.approx(2.0e-3, abs=1e-8)
    assert chapter_6.stability_limit(one) == pytest.approx(2.785293563e-3, abs=1e-8)


# --------------------------------------------------------------------------- single statements


def test_printed_constant_of_d22_comes_from_the_sign_of_a3():
    assert chapter_4.d22_constant(-0.0191) == pytest.approx(2.3616 + 3.0501, abs=1e-4)
    assert chapter_4.d22_constant(+0.0191) == pytest.approx(2.3616 + 3.0574, abs=1e-4)


def test_row_on_equation_5_2_quotes_the_load_of_the_stretched_arm():
    (erratum,) = (erratum for erratum in ERRATA if erratum.key == "5.2 gear")
    load = abs(reference.gravity(np.array([0.0, 0.0, math.pi / 2]))[1])
    assert erratum.quantity.endswith(f", {load:.2f} N.m")


def test_every_misprint_in_the_numbers_of_section_4_5_has_a_row():
    rows = " ".join(erratum.key for erratum in ERRATA)
    for name, terms in printed_coefficients.COEFFICIENTS.items():
        if any(term.printed != term.corrected for term in terms):
            assert f"4.5 {name}" in rows


def test_every_misprint_of_the_equations_in_symbols_has_a_row():
    given = [erratum.proof.keywords for erratum in ERRATA if "slip" in erratum.proof.keywords]
    proved = {(each["name"], each["slip"]) for each in given if "name" in each}
    equations = chapter_4_forms.EQUATIONS.items()
    assert proved == {(name, slip) for name, equation in equations for slip in equation.get("slips", ())}


def test_a_misprint_that_is_no_part_of_its_equation_is_refused(monkeypatch):
    monkeypatch.setitem(chapter_4_forms.EQUATIONS, "X", {"correct": "a2 + a2", "slips": {"y": ["y2", "y3"]}})
    s = chapter_4_forms.symbols((0.0, 0.1, 0.2), reference.nominal())
    assert chapter_4_forms.evaluate("X", s) == 2 * reference.nominal().a2
    with pytest.raises(ParameterError, match="X, y: 0 times 'y2'; expected one"):
        chapter_4_forms.evaluate("X", s, ("y",))


def test_eigenvalues_that_the_row_on_section_6_3_quotes():
    assert chapter_6.smallest_eigenvalue_of_d() == pytest.approx(-0.405, abs=5e-4)
    added = np.diag(reference.nominal().motor_inertia)
    for sign in (1, -1):
        lowest = reference.inertia(np.array([0, sign * math.pi / 2, -math.pi / 2]))
        assert np.linalg.eigvalsh(lowest)[0] == pytest.approx(-0.405, abs=5e-4)
    least = min(
        np.linalg.eigvalsh(reference.inertia(np.radians([0, q2, q3])) + added)[0]
        for q2 in range(-180, 180, 15)
        for q3 in range(-180, 180, 15)
    )
    assert 0.760 <= least < 0.80


def test_only_the_captions_that_differ_from_the_text_are_listed():
    listed = {erratum.key.split()[1] for erratum in ERRATA if erratum.key.startswith("caption")}
    contents = references.CONTENTS
    differ = {plot for plot in contents["text"] if contents["text"][plot] != contents["captions"][plot]}
    shown, said = contents["voltage_plots"], contents["voltage_captions"]
    differ |= {plot for plot in shown if shown[plot] != said[plot]}
    assert listed == differ


# --------------------------------------------------------------------------------- the evidence


@pytest.mark.parametrize(
    "reference_, correct, printed, tolerance, proved",
    [
        (1.0, 1.0, 2.0, 0.0, True),
        (1.0, 1.0, 1.0, 0.0, False),  # no difference: no misprint
        (1.0, 2.0, 1.0, 0.0, False),  # exchanged
        (1.0, 1.0, 1.2, 0.1, False),  # too near to be told from the tolerance
        ([1.0, 2.0], [1.0, 2.0], [1.0, 2.5], 1e-9, True),
        ([1.0, 2.0], [1.0, 2.0], 1.0, 1e-9, True),  # of another shape
        ("9 x 3", "9 x 3", "3 x 9", 0.0, True),
        (frozenset("ab"), frozenset("ab"), frozenset("a"), 0.0, True),
        (Between(0.0, math.inf), 0.7, -0.4, 0.0, True),
        (Between(0.0, 1.0), 0.7, 0.9, 0.0, False),
    ],
)
def test_what_counts_as_proof(reference_, correct, printed, tolerance, proved):
    assert Evidence("x", "", "test", reference_, correct, printed, tolerance).proved is proved


# ----------------------------------------------------------------------------- texts and proofs

ENTRY = {
    "key": "9.9 x",
    "where": "equation 9.9",
    "printed": "x",
    "correct": "x^2",
    "quantity": "square of 3",
    "by": "three threes",
    "proof": "square",
    "given": {"x": 3.0},
}


def prove_square(x, reference=9.0):
    return reference, x**2, x


def errata_of(tmp_path, *entries, **functions):
    path = tmp_path / "errata.yaml"
    path.write_text(json.dumps(entries), encoding="utf-8")
    return read_errata(path, {"prove_square": prove_square, "other": None, **functions})


def test_an_erratum_is_made_of_its_entry_and_the_function_that_it_names(tmp_path):
    (erratum,) = errata_of(tmp_path, ENTRY)
    evidence = erratum.evidence()
    assert (erratum.key, erratum.where, erratum.note) == ("9.9 x", "equation 9.9", "")
    assert (evidence.reference, evidence.correct, evidence.printed) == (9.0, 9.0, 3.0)
    assert evidence.proved


def test_several_errata_share_a_function(tmp_path):
    given = {"x": 2.0, "reference": {"low": 4, "high": 5}}
    first, second = errata_of(tmp_path, ENTRY, {**ENTRY, "key": "9.9 y", "given": given})
    assert second.evidence().reference == Between(4, 5)
    assert first.evidence().reference == 9.0


@pytest.mark.parametrize(
    "change, words",
    [
        ({"by": None}, "'by'"),
        ({"colour": "red"}, "'colour'"),
        ({"printed": 0.018}, "printed = 0.018; expected a text"),
        ({"proof": "cube"}, "no function prove_cube"),
        ({"proof": None}, "no function prove_None"),
        ({"given": {}}, "missing a required argument: 'x'"),
        ({"given": {"x": 3.0, "z": 1.0}}, "unexpected keyword argument 'z'"),
    ],
)
def test_an_unusable_entry_is_named(tmp_path, change, words):
    entry = {name: value for name, value in {**ENTRY, **change}.items() if value is not None}
    with pytest.raises(ParameterError) as caught:
        errata_of(tmp_path, entry)
    assert "errata.yaml, '9.9 x': " in str(caught.value) and words in str(caught.value)


def test_a_key_that_stands_twice_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="'9.9 x': the key stands twice"):
        errata_of(tmp_path, ENTRY, ENTRY)


def test_a_proof_without_an_erratum_is_refused(tmp_path):
    with pytest.raises(ParameterError, match=r"no erratum for \['lost'\]"):
        errata_of(tmp_path, ENTRY, prove_lost=prove_square)


# ------------------------------------------------------------------------------- the experiment


@pytest.fixture(scope="module")
def result():
    return errata.run(Context(seed=1))


def test_experiment_lists_every_row_and_leaves_none_unproved(result):
    assert result.numbers["unproved"] == []
    assert [row.quantity for row in result.rows[:-1]] == [erratum.where for erratum in ERRATA]
    assert all(row.note for row in result.rows)


def test_experiment_depends_on_nothing_but_the_data(result):
    again = errata.run(Context(seed=2))
    assert again.rows == result.rows and again.numbers == result.numbers


def test_numbers_of_section_4_5_move_the_arm_as_the_model_once_corrected(result):
    apart = result.numbers["motion with the numbers of section 4.5"]
    # four digits of 2.5 kg.m^2 and 52 N.m behind gears: far below what the misprints do
    assert max(apart["corrected_apart_rad"]) < 1e-5
    assert max(apart["printed_apart_rad"]) > 1e-3
