# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Answers of several logs of one machine beside each other: Cochran's Q, and what the report says of it."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from loop_support import named
from scipy.stats import chi2

from puma_sim_core.identify import explain
from puma_sim_core.identify.report.html import page
from puma_sim_core.identify.report.json import report_mapping, report_text
from puma_sim_core.identify.several.agreement import agreement, heterogeneity
from puma_sim_core.resources import config_path

FRICTION = ("coulomb_friction", 2)


def with_torque(value, half):
    """A report that names friction of a size."""
    found = copy.deepcopy(report_mapping(named()))
    found["effects"][0]["parameters"]["torque"] |= {"value": value, "ci95": [value - half, value + half]}
    return found


def without(excited=True, tie=False):
    """A report that names no friction, or another effect that is tied with it."""
    found = with_torque(1.0, 0.1)
    found["verdict"] = "NAMED"
    row = next(d for d in found["detectability"] if (d["name"], d["joint"]) == FRICTION)
    row["size"] = 0.8 if excited else "NOT_EXCITED"
    effect = {"name": "voltage_dead_band", "joint": 2, "parameters": {}, "evidence": 20.0, "ruled_out": []}
    effect["tied_with"] = [{"name": FRICTION[0], "joint": FRICTION[1]}] if tie else []
    found["effects"] = [effect]
    return found


def test_q_of_equal_errors_is_the_scatter_over_the_error():
    values, error = np.array([1.0, 2.0, 4.0]), 0.5
    mean, own, q, p = heterogeneity(values, [error] * 3, [error] * 3)
    assert mean == pytest.approx(values.mean())
    assert q == pytest.approx(2.0 * values.var(ddof=1) / error**2)
    assert p == pytest.approx(math.exp(-q / 2.0))  # chi-square with two degrees of freedom
    # Birge: the scatter gives the error of the mean where it is larger
    assert own == pytest.approx(values.std(ddof=1) / math.sqrt(3.0))


def test_the_test_rejects_one_true_value_as_often_as_it_says():
    rng = np.random.default_rng(7)
    errors = np.array([0.3, 1.0, 0.1, 0.5])
    found = [heterogeneity(5.0 + errors * rng.standard_normal(4), errors, errors) for _ in range(4000)]
    assert np.mean([p < 0.05 for *_, p in found]) == pytest.approx(0.05, abs=0.011)
    assert np.mean([q for *_, q, _ in found]) == pytest.approx(3.0, rel=0.05)


def test_an_interval_counts_by_its_half_on_the_side_of_the_mean():
    """The mean is the greatest of the product of likelihoods of two half parabolas, and Q twice what that lacks."""
    values, below, above = np.array([0.57, 0.37, 0.45]), np.array([0.026, 0.016, 0.04]), np.array([0.024, 0.11, 0.02])
    grid = np.linspace(0.3, 0.6, 300001)
    away = values[:, None] - grid
    falls = np.where(away > 0.0, away / below[:, None], away / above[:, None]) ** 2
    mean, _, q, _ = heterogeneity(values, below, above)
    assert mean == pytest.approx(grid[falls.sum(axis=0).argmin()], abs=2e-6)
    assert q == pytest.approx(falls.sum(axis=0).min(), rel=1e-9)
    # the mirror image has the same scatter
    other, _, same, _ = heterogeneity(-values, above, below)
    assert (other, same) == (pytest.approx(-mean), pytest.approx(q))
    assert heterogeneity([2.0, 2.0], [0.1, 0.2], [0.3, 0.1])[::2] == (2.0, 0.0)


def test_a_table_has_each_log_and_the_test_of_each_size():
    reports = [
        with_torque(10.0, 0.5),
        with_torque(10.4, 0.5),
        without(),
        without(excited=False),
        without(tie=True),
        None,
    ]
    found = agreement([f"{n}.csv" for n in range(6)], reports)
    friction = next(e for e in found.effects if (e.name, e.joint) == FRICTION)
    assert friction.states == ("named", "named", "not named", "not excited", "tied", "no answer")
    (size,) = friction.sizes
    assert [each is not None for each in size.found] == [True, True, False, False, False, False]
    assert size.mean.value == pytest.approx(10.2) and size.i2 < 0.3 and size.agrees
    s = 0.5 / 1.959964
    assert size.p_value == pytest.approx(chi2.sf(0.5 * (0.4 / s) ** 2, 1), rel=1e-4)
    assert "named by 2 of 6 logs and tied in 1" in found.sentence and "exclude" not in found.sentence
    apart = agreement(["a", "b"], [with_torque(10.0, 0.5), with_torque(12.0, 0.5)])
    assert not apart.effects[0].sizes[0].agrees and apart.effects[0].sizes[0].i2 > 0.9
    assert "exclude each other in torque of Coulomb friction" in apart.sentence
    nothing = agreement(["a", "b"], [{**without(), "effects": []}] * 2)
    assert nothing.effects == () and "the same verdict" in nothing.sentence


def by_load(coefficient, transmitted, half=0.05):
    """A report that names friction by the load, of a share of the motor's torque."""
    found = with_torque(1.0, 0.1)
    size = {"value": coefficient, "unit": "1", "ci95": [coefficient - half, coefficient + half]}
    given = {"value": transmitted, "unit": "1", "ci95": [transmitted, transmitted]}
    effect = {"name": "load_dependent_friction", "joint": 1, "evidence": 50.0, "tied_with": [], "ruled_out": []}
    found["effects"] = [{**effect, "parameters": {"coefficient": size, "transmitted": given}}]
    return found


def test_sizes_of_different_laws_are_not_compared():
    """A share of the motor's torque and one of what the teeth bear are two quantities."""
    reports = [by_load(0.5, 1.0), by_load(0.3, 0.72), by_load(0.52, 1.0), by_load(0.31, 0.70)]
    found = agreement(["a", "b", "c", "d"], reports)
    (effect,) = found.effects
    assert effect.states == ("named",) * 4
    motor, teeth = effect.sizes
    assert (motor.law_words, teeth.law_words) == ("transmitted 1", "transmitted 0.72")
    assert [each is not None for each in motor.found] == [True, False, True, False]
    assert motor.mean.value == pytest.approx(0.51) and teeth.mean.value == pytest.approx(0.305)
    assert motor.agrees and teeth.agrees and "different laws" in found.sentence and "transmitted 0.72" in found.sentence
    assert "different laws" not in agreement(["a", "c"], reports[::2]).sentence
    assert not agreement(["a", "b"], [by_load(0.5, 1.0), by_load(0.3, 1.0)]).effects[0].sizes[0].agrees
    # one between two laws counts once
    chain = agreement(["a", "b", "c"], [by_load(0.5, 0.70), by_load(0.5, 0.83), by_load(0.5, 0.765)])
    assert [sum(each is not None for each in size.found) for size in chain.effects[0].sizes] == [2, 1]


def test_a_push_has_no_size_that_another_log_could_give():
    pushed = with_torque(1.0, 0.1)
    pushed["effects"][0] |= {"name": "impulse"}
    (effect,) = agreement(["a", "b"], [pushed, pushed]).effects
    assert effect.states == ("named", "named") and effect.sizes == ()


def test_report_and_page_have_the_table():
    found = agreement(["day/a.csv", "day/b.csv"], [with_torque(10.0, 0.5), with_torque(12.0, 0.5)])
    made = replace(named(), agreement=found, logs=found.logs)
    schema = json.loads(config_path("explain_report.schema.json").read_text(encoding="utf-8"))
    report = json.loads(report_text(made))
    jsonschema.Draft202012Validator(schema).validate(report)
    (size,) = report["agreement"]["effects"][0]["sizes"]
    assert size["q"] == pytest.approx(0.5 * (2.0 * 1.959964 / 0.5) ** 2, rel=1e-3) and not size["agrees"]
    text = page(made)
    section = text.split('<section id="agreement">')[1].split("</section>")[0]
    assert "b.csv" in section and "Cochran" in section and "11.0" in section
    laws = page(replace(named(), agreement=agreement(["a", "b"], [by_load(0.5, 1.0), by_load(0.3, 0.72)])))
    rows = laws.split('<section id="agreement">')[1].split("</tr>")
    assert "transmitted 1" in rows[1] and "transmitted 0.72" in rows[2]
    assert '<section id="agreement">' not in page(named())


@pytest.mark.thorough
def test_two_halves_of_a_log_give_the_same_answer(tmp_path):
    """The sample log of the pendulum, which lacks Coulomb friction, as two logs."""
    lines = (Path(__file__).parents[1] / "examples" / "pendulum.csv").read_text().splitlines()
    paths = [tmp_path / "first.csv", tmp_path / "second.csv"]
    for path, own in zip(paths, (lines[1:1001], lines[1001:])):
        path.write_text("\n".join([lines[0], *own]) + "\n")
    found = explain(paths, plant="pendulum", agreement=True)
    assert [(e.name, e.joint) for e in found.effects] == [("coulomb_friction", 1)]
    table = found.agreement
    assert table.logs == tuple(map(str, paths))
    (friction,) = (e for e in table.effects if e.name == "coulomb_friction")
    # five seconds of the second half do not tell it from another effect
    assert friction.states[0] == "named" and friction.states[1] in ("named", "tied")
    (torque,) = friction.sizes
    assert torque.found[0] is not None and torque.agrees
