# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`explain` on records of another engine, with effects that it is not told of.

The answers are read by the assertions alone, after the record was explained.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

pytest.importorskip("scipy")

from report_checks import contradictions
from score import scoring

from puma_sim_core.identify import explain
from puma_sim_core.identify.report.json import report_mapping, report_text

RECORDS = Path(__file__).parent / "blind" / "records"
#: open loop, and under feedback
NOTHING = ("record_001000", "record_001002")
SINGLE = ("record_001004", "record_001014", "record_001015")
PAIR, OUTSIDE = "record_001016", "record_001018"
FAULTS = ("record_001020", "record_001021", "record_001022", "record_001023")
#: one record of each other kind at least is explained wherever these tests run
LONGEST = (*SINGLE, PAIR)
#: seconds that a record may take on a machine that does much else, compilation included
pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]


def each(*names: str):
    """Parameters of a test, those of the longest records for all tests alone."""
    return [pytest.param(name, marks=[pytest.mark.thorough] if name in LONGEST else []) for name in names]


def path_of(name: str) -> str:
    return str(RECORDS / f"{name}.csv")


@cache
def explanation(name: str):
    return explain(path_of(name))


def explained(name: str) -> dict:
    """What is said of a record, as report.json has it; nothing else is known of it."""
    return report_mapping(explanation(name))


def answer(name: str) -> dict:
    return json.loads((RECORDS / "answers.json").read_text())[name]


def assert_held_out_falls(report: dict) -> None:
    """By what is named, and far below that of the nominal model."""
    error = {stage: scoring.held_out(report, stage) for stage in ("nominal", "retuned", "augmented")}
    assert error["augmented"] < 0.7 * error["retuned"] and error["augmented"] < error["nominal"]


@pytest.mark.parametrize("name", NOTHING)
def test_nothing_is_missing_where_parameters_are_only_wrong(name):
    report = explained(name)
    assert report["verdict"] == "NOTHING_MISSING" and report["effects"] == []
    assert scoring.held_out(report, "retuned") < 0.5 * scoring.held_out(report, "nominal")
    assert scoring.kind_of(answer(name)) == "nothing"
    # an honest sentence: it says of each effect what it would have seen
    assert any(row["size"] != "NOT_EXCITED" for row in report["detectability"])


@pytest.mark.thorough
def test_slow_noise_is_nothing_that_is_missing(tmp_path):
    """A development record: with its correlation of 50 ms the noise makes 13 times as much in open loop as if white."""
    pytest.importorskip("mujoco")
    from blind import generate
    from score import plan

    (recipe,) = (recipe for recipe in plan.plan({"nothing": 60}, 2900) if recipe.seed == 2947)
    path, truth = generate.make(recipe, tmp_path)
    assert truth["correlation_ms"] > 50.0 and scoring.kind_of(truth) == "nothing"
    report = report_mapping(explain(str(path)))
    assert report["verdict"] == "NOTHING_MISSING" and report["effects"] == []


@pytest.mark.parametrize("name", each(*SINGLE))
def test_the_effect_is_named_with_its_joint(name):
    report = explained(name)
    assert report["verdict"] in ("NAMED", "NAMED_WITH_REMAINDER")
    assert scoring.said_of(report) == scoring.truth_of(answer(name))
    assert_held_out_falls(report)


@pytest.mark.thorough
def test_both_effects_of_a_pair_are_named():
    report = explained(PAIR)
    assert sorted(scoring.said_of(report)) == sorted(scoring.truth_of(answer(PAIR)))
    assert_held_out_falls(report)


@pytest.mark.thorough
def test_a_wide_gap_is_named_where_it_stretched_the_parameters(tmp_path):
    """A record of a score: by runs about such parameters alone a gap of 0.15 mrad was tried, and nothing missing."""
    pytest.importorskip("mujoco")
    from blind import generate
    from score import plan

    (recipe,) = (recipe for recipe in plan.plan(plan.counts(340), 999640) if recipe.seed == 999865)
    path, truth = generate.make(recipe, tmp_path)
    first = report_mapping(explain(str(path)))["effects"][0]
    assert (first["name"], first["joint"]) == ("backlash", 1)
    (true,) = truth["effects"]
    assert first["parameters"]["gap"]["value"] == pytest.approx(true["parameters"]["gap"], rel=0.05)


@pytest.mark.thorough
def test_a_payload_is_named_beside_a_current_limit_that_is_in_use(tmp_path):
    """A development record: the limit gains twenty thousand times as much as the payload beside it."""
    pytest.importorskip("mujoco")
    from blind import generate
    from score import plan

    (recipe,) = (recipe for recipe in plan.plan({"case": 26, "nothing": 4}, 2500) if recipe.seed == 2507)
    path, truth = generate.make(recipe, tmp_path)
    report = report_mapping(explain(str(path)))
    assert report["verdict"] == "NAMED"
    assert scoring.said_of(report) == [("current_limit", 2), ("payload", None)]
    assert sorted(scoring.truth_of(truth), key=str) == sorted(scoring.said_of(report), key=str)
    mass = next(effect["parameters"]["mass"]["value"] for effect in report["effects"] if effect["name"] == "payload")
    assert mass == pytest.approx(truth["effects"][0]["parameters"]["mass"], rel=0.15)


def test_what_is_outside_the_library_has_no_name_but_a_shape():
    report = explained(OUTSIDE)
    assert report["verdict"] in scoring.ABSTAINED
    shape, outside = report["shape"], answer(OUTSIDE)["outside"]
    assert scoring.axis_right(shape, outside) and shape["joint"] == outside["joint"]
    if "line_hz" in outside:
        assert shape["line_hz"] == pytest.approx(outside["line_hz"], abs=0.2)


@pytest.mark.parametrize("name", FAULTS)
def test_faulty_data_get_no_name_but_channel_and_row(name):
    report = explained(name)
    assert report["effects"] == [] and report["shape"] is None
    right = scoring.fault_right({"report": report}, answer(name)["faults"])
    assert right == (True, True, True), report["faults"]


@pytest.mark.parametrize("name", each(*NOTHING, *SINGLE, PAIR, OUTSIDE, *FAULTS))
def test_a_report_agrees_with_itself(name):
    assert contradictions(explained(name)) == []


@pytest.mark.thorough
def test_most_intervals_hold_the_truth():
    held = {}
    for name in (*SINGLE, PAIR):
        held |= {(name, key): inside for key, inside in scoring.coverage(explained(name), answer(name))}
    assert len(held) >= 5
    assert sum(held.values()) >= 0.7 * len(held), held


@pytest.mark.thorough
def test_the_same_record_gives_the_same_report_to_the_byte():
    def text(found):
        lines = report_text(found).splitlines()
        return [line for line in lines if not line.lstrip().startswith('"seconds"')]

    once, again = text(explanation(SINGLE[0])), text(explain(path_of(SINGLE[0])))
    assert once == again and len(once) > 50
