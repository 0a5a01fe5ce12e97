# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How blind records are scored: every rule on rows made by hand, and that the sets stay apart."""

from __future__ import annotations

import json
import math
import re
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from threading import Thread

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("scipy")

from blind import records
from score import plan, run, table
from score.rates import clopper_pearson, wilson
from score.scoring import axis_right, coverage, fault_right, kind_of, over_joints, row_of, tie_aware


def effect(name, joint, size=3.0, **parameters):
    return {"name": name, "joint": joint, "size": size, "distinct_size": size, "parameters": parameters}


def said(name, joint, ties=(), **intervals):
    return {
        "name": name,
        "joint": joint,
        "evidence": 50.0,
        "tied_with": [{"name": n, "joint": j} for n, j in ties],
        "parameters": {key: {"value": sum(ci) / 2, "ci95": list(ci), "unit": "1"} for key, ci in intervals.items()},
    }


def report(verdict, *effects, shape=None, faults=(), augmented=1.0, retuned=2.0):
    position = {"nominal": [4.0] * 3, "retuned": [retuned] * 3, "augmented": [augmented] * 3, "floor": [0.5] * 3}
    return {
        "verdict": verdict,
        "effects": list(effects),
        "shape": shape,
        "ranking": [],
        "faults": [{"channel": c, "row": r, "what": "x"} for c, r in faults if verdict == "DATA_FAULT"],
        "cuts": [{"channel": c, "row": r, "what": "x"} for c, r in faults if verdict != "DATA_FAULT"],
        "errors": {"fit": None, **{part: {"position_rms": position} for part in ("held_out", "unseen")}},
    }


def answer(*effects, outside=None, faults=()):
    return {
        "effects": list(effects),
        "outside": outside,
        "faults": list(faults),
        "size": 3.0,
        "recipe": {"fault": "gap" if faults else None},
        "sampling_ms": 1.0,
        "motion": "fourier",
        "feedback": True,
        "dither": None,
    }


def reached(errors):
    """What the true structure leaves."""
    return {"held_out": errors, "unseen": errors}


def outcome(answered, reported, **more):
    return {
        "record": "record_002000",
        "answer": answered,
        "report": reported,
        "error": None,
        "crash": None,
        "skipped": False,
        "seconds": 3.0,
        "megabytes": 300,
        **more,
    }


@pytest.mark.parametrize(
    "right, count, low, high",
    [
        # Newcombe 1998, Statistics in Medicine 17:857, table I
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_is_that_of_the_literature(right, count, low, high):
    assert wilson(right, count) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize(
    "right, count, low, high",
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0578, 0.1617), (0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_clopper_and_pearson_is_that_of_the_literature(right, count, low, high):
    assert clopper_pearson(right, count) == pytest.approx((low, high), abs=5e-5)
    # exact: the tails at its ends hold 2.5 % each
    for p, ks in ((low, range(right, count + 1)), (high, range(right + 1))):
        tail = sum(math.comb(count, k) * p**k * (1 - p) ** (count - k) for k in ks)
        assert p in (0.0, 1.0) or tail == pytest.approx(0.025, rel=0.06)


def test_intervals_of_nothing_and_of_all():
    assert wilson(0, 0) == clopper_pearson(0, 0) == (0.0, 1.0)
    assert wilson(5, 5)[1] == clopper_pearson(5, 5)[1] == 1.0


def test_a_tie_counts_only_with_its_joint_and_only_beside_a_name():
    truth = [("input_delay", None)]
    assert tie_aware(report("NAMED", said("sensor_lag", 1, [("input_delay", None)])), truth)
    assert tie_aware(report("NAMED", said("input_delay", None)), truth)
    assert not tie_aware(report("NAMED", said("sensor_lag", 1, [("sensor_lag", 2)])), truth)
    assert not tie_aware(report("NOTHING_MISSING"), truth)
    both = [("payload", None), ("voltage_offset", 2)]
    assert not tie_aware(report("NAMED", said("payload", None)), both)
    assert tie_aware(report("NAMED", said("payload", None, [("voltage_offset", 2)])), both)


def test_axes_of_what_is_outside_the_library():
    outside = {"axis": "voltage", "also": ["velocity"]}
    assert axis_right({"axis": "voltage"}, outside) and axis_right({"axis": "velocity"}, outside)
    assert not axis_right({"axis": "position"}, outside) and not axis_right(None, outside)
    anything = {"axis": None, "also": []}
    assert axis_right({"axis": "time"}, anything) and not axis_right(None, anything)


def test_faults_by_channel_and_row():
    gap = [{"channel": "time", "row": 400, "what": "gap"}]

    def right(faults, verdict, *found, error=None):
        return fault_right({"report": report(verdict, faults=found), "error": error}, faults)

    assert right(gap, "DATA_FAULT", ("time", 402)) == (True, True, True)
    assert right(gap, "DATA_FAULT", ("time", 420)) == (True, True, False)
    assert right(gap, "DATA_FAULT", ("time", None)) == (True, True, False)
    assert right(gap, "DATA_FAULT", ("voltage1", 400)) == (True, False, False)
    # the log was read without the row
    assert right(gap, "NAMED", ("time", 400)) == (True, True, True)
    assert right(gap, "NAMED") == (False, False, False)
    swapped = [{"channel": f"position{j}", "row": None, "what": "swapped"} for j in (1, 3)]
    assert right(swapped, "DATA_FAULT", ("position3", None)) == (True, True, True)
    assert right(swapped, "DATA_FAULT", ("position2", None)) == (True, False, False)
    assert right(swapped, "DATA_FAULT", ("position1", 7)) == (True, True, False)
    anyone = [{"channel": None, "row": None, "what": "at rest"}]
    assert right(anyone, "DATA_FAULT", ("position2", None)) == (True, True, True)
    text = [{"channel": "voltage2", "row": 31, "what": "not a number"}]
    assert right(text, "", error="a.csv, line 32, column voltage2: 'ERR'") == (True,) * 3
    assert right(text, "", error="a.csv, line 33, column voltage1: 'ERR'") == (True, False, False)


def test_coverage_counts_what_was_fitted_and_named_right():
    answered = answer(effect("torque_ripple", 2, amplitude=2.0, order=1.0, phase=3.0))
    ripple = said("torque_ripple", 2, amplitude=(1.5, 1.9), order=(1.0, 1.0), phase=(-3.4, -3.2))
    found = dict(coverage(report("NAMED", ripple), answered))
    assert found == {"torque_ripple.amplitude": False, "torque_ripple.phase": True}
    elsewhere = said("torque_ripple", 1, amplitude=(0.0, 9.0))
    assert coverage(report("NAMED", elsewhere), answered) == []


def test_single_effects():
    answered = answer(effect("coulomb_friction", 2, 4.0))
    row = row_of(
        outcome(
            answered,
            report("NAMED", said("coulomb_friction", 2)),
            true_structure={"held_out": [0.8] * 3, "unseen": [0.9] * 3},
        )
    )
    assert row["kind"] == "single" and row["size"] == 4.0
    assert row["top1"] and row["exact"] and row["joint_right"] and not row["needless"]
    assert row["ratio"] == pytest.approx(1.25) and row["worse"] is False
    assert row["baselines"]["retuning"]["ratio"] == pytest.approx(2.5)
    row = row_of(
        outcome(answered, report("NAMED", said("coulomb_friction", 3), said("voltage_offset", 2), augmented=2.5))
    )
    assert row["top1"] and not row["exact"] and not row["joint_right"] and row["needless"]
    assert row["worse"] is True and row["ratio"] is None
    assert row["unseen_worse"] is True and row["only_here"]
    unlucky = row_of(
        outcome(
            answered,
            report("NAMED", said("coulomb_friction", 2), augmented=2.5),
            true_structure={"held_out": [1.9] * 3, "unseen": [2.4] * 3},
        )
    )
    assert unlucky["unseen_worse"] is True and not unlucky["only_here"]
    row = row_of(outcome(answered, report("NOTHING_MISSING")))
    assert not row["top1"] and not row["named"]
    assert row["worse"] is None and row["unseen_worse"] is None and not row["only_here"]


def test_nothing_missing_pairs_and_outsiders():
    quiet = row_of(outcome(answer(), report("NOTHING_MISSING", augmented=2.0)))
    assert not quiet["alarm"] and quiet["ratio"] == 1.0
    assert row_of(outcome(answer(), report("UNNAMED")))["alarm"]
    false = row_of(outcome(answer(), report("NAMED", said("payload", None))))
    assert false["alarm"] and false["false_name"]
    pair = answer(effect("payload", None, 5.0), effect("voltage_offset", 1, 2.0))
    row = row_of(outcome(pair, report("NAMED", said("voltage_offset", 1), said("payload", None))))
    assert row["both"] and row["one"] and row["size"] == 2.0 and row["top1"]
    row = row_of(outcome(pair, report("NAMED", said("voltage_offset", 1))))
    assert not row["both"] and row["one"]
    strange = answer(outside={"what": "shake", "joint": 2, "axis": "time", "also": []})
    shape = {"axis": "time", "joint": 2}
    row = row_of(outcome(strange, report("NAMED_WITH_REMAINDER", said("payload", None), shape=shape)))
    assert row["abstained"] and row["axis_right"] and row["shape_joint"]
    assert not row_of(outcome(strange, report("NAMED", said("payload", None))))["abstained"]
    assert kind_of(strange) == "outside" and kind_of(pair) == "pair"


def test_a_baseline_that_cannot_be_run_has_no_finite_error():
    answered = answer(effect("coulomb_friction", 2, 4.0))
    made = {"forward": {"names": [["coulomb_friction", 2], ["payload", None]], "position_rms": None}}
    row = row_of(outcome(answered, report("NOTHING_MISSING"), true_structure=reached([1.0] * 3), baselines=made))
    forward = row["baselines"]["forward"]
    made["forward"]["position_rms"] = [1.2] * 3
    run = row_of(
        outcome(
            answered,
            report("NOTHING_MISSING"),
            baselines=made,
            true_structure={"held_out": [1.0] * 3, "unseen": [0.8] * 3},
        )
    )
    # its parameters were fitted to all of the log but what no choice has seen
    assert run["baselines"]["forward"]["ratio"] == pytest.approx(1.5)
    assert forward["top1"] and forward["needless"] and forward["ratio"] == math.inf


def test_errors_over_the_joints():
    assert over_joints([3.0, 4.0, 0.0]) == pytest.approx(5.0 / math.sqrt(3.0))
    assert over_joints([1.0, None, 0.0]) is None and over_joints(None) is None


def test_the_table_counts_what_the_rows_say():
    good = answer(effect("coulomb_friction", 2, 4.0))
    small = answer(effect("coulomb_friction", 2, 0.3))
    outcomes = [
        outcome(good, report("NAMED", said("coulomb_friction", 2)), true_structure=reached([1.0] * 3)),
        outcome(good, report("NAMED", said("payload", None)), true_structure=reached([0.5] * 3)),
        outcome(small, report("NOTHING_MISSING")),
        outcome(answer(), report("NOTHING_MISSING")),
        outcome(
            answer(faults=[{"channel": "time", "row": 9, "what": "gap"}]), report("DATA_FAULT", faults=[("time", 9)])
        ),
        {**outcome(answer(), None), "error": "a crash"},
    ]
    shown = table.text([row_of(each) for each in outcomes], "Seeds 1 to 6")
    lines = {line[:47].strip(): line[47:] for line in shown.splitlines()}
    assert lines["right name first, size 1.5 and more"].startswith("1/2 50.0 % [9, 91]")
    assert lines["alarms where nothing is missing"].startswith("1/2")
    assert lines["records that ended in an error"].startswith("1")
    assert lines["held-out error / true structure: median"].startswith("1.500")
    assert "Left out of accuracy: 1 records" in shown
    assert "payload" in lines["coulomb_friction"]
    for each in outcomes:
        assert "record_002000" in table.line(each)
    # the small one is left out, and the others that are right are no misses
    misses = shown.split("Every miss")[1].splitlines()[1:]
    assert [line.split(" -> ")[1] for line in misses] == ["NAMED payload", "ERROR"]


def test_cases_have_rows_of_their_own():
    oscillating = {**answer(effect("input_delay", None, 4.0)), "recipe": {"fault": None, "case": "delay_oscillating"}}
    good, bad = (outcome(oscillating, report("NAMED", said(name, None))) for name in ("input_delay", "payload"))
    shown = table.text([row_of(good), row_of(bad)])
    assert re.search(r"^  delay_oscillating +1/2$", shown, re.MULTILINE)
    assert "[delay_oscillating] input_delay size 4 -> NAMED payload" in shown
    assert not re.search(r"^  input_delay +1/2", shown, re.MULTILINE)


def test_a_whole_score_holds_what_was_asked_for():
    recipes = plan.plan(plan.counts(plan.COUNT), plan.FINAL_SEED)
    assert len(recipes) == len({recipe.seed for recipe in recipes}) >= 300
    assert sum(not (r.effects or r.outside or r.fault) for r in recipes) >= 150
    single = [recipe.effects[0][0] for recipe in recipes if len(recipe.effects) == 1 and not recipe.case]
    assert {single.count(name) for name in records.EFFECTS} == {4}
    assert {sum(recipe.case == case for recipe in recipes) for case in records.CASES} == {5}
    assert {r.fault for r in recipes} - {None} == set(records.FAULTS)
    assert {r.outside[0] for r in recipes if r.outside} == set(records.OUTSIDE)
    assert sum(len(recipe.effects) == 2 for recipe in recipes) >= 25
    assert all(0.6 <= size <= 10.0 for recipe in recipes for size in recipe.sizes)
    assert all(sum(plan.counts(n).values()) == n for n in (1, 7, 40, 341))


@pytest.mark.parametrize(
    "seed, development, allowed",
    [
        (920_000, False, True),
        (919_999, False, False),
        (2300, False, False),
        (2300, True, True),
        (1090, True, False),
        (2990, True, False),
        (920_000, True, False),
    ],
)
def test_seeds_of_scores_and_of_development_are_never_mixed(seed, development, allowed, tmp_path, capsys):
    if allowed:
        plan.check_seeds(seed, 20, development)
        return
    with pytest.raises(plan.SeedError):
        plan.check_seeds(seed, 20, development)
    given = ["--seed", str(seed), "--count", "20", "--out", str(tmp_path / "score")]
    assert run.main(given + ["--development"] * development) == 2
    assert "seed" in capsys.readouterr().err and not (tmp_path / "score").exists()


def test_a_batch_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    made = []

    def work(recipe, folder, small):
        made.append(recipe.seed)
        if len(made) == 3:
            raise KeyboardInterrupt
        return outcome(answer(), report("NOTHING_MISSING"))

    monkeypatch.setattr(run.jobs, "work", work)
    monkeypatch.setattr(run.jobs, "warm_up", lambda: None)
    monkeypatch.setattr(run.jobs, "seconds_alone", lambda recipe, folder: 7.0)
    given = ["--only", "nothing=4", "--processes", "1", "--out", str(tmp_path)]
    with pytest.raises(KeyboardInterrupt):
        run.main(given)
    with open(tmp_path / "outcomes.jsonl", "a") as file:
        file.write('{"code": "cut sho')
    assert run.main(given) == 0
    assert len(made) == 5 and len(set(made)) == 4
    said = capsys.readouterr().out
    assert "2 of them explained before" in said and "7.0, 7.0, 7.0" in said
    summary = json.loads((tmp_path / "score.json").read_text())
    assert len(summary["rows"]) == 4 and not summary["development"]
    monkeypatch.setattr(run.jobs, "fingerprint", lambda: "other code")
    assert run.main(given) == 0 and len(made) == 9


def _failing(begun, ended, wrong, recipe, folder, small):
    (begun / str(recipe.seed)).touch()
    if recipe.seed == wrong:
        raise RuntimeError("cannot be made")
    while not ended.exists():
        time.sleep(0.01)
    return outcome(answer(), report("NOTHING_MISSING"))


def test_a_batch_of_several_processes_ends_at_an_error(tmp_path, monkeypatch):
    """At the error, rather than when all that waits has been done."""
    begun, ended, first = tmp_path / "begun", tmp_path / "ended", plan.plan({"nothing": 40}, plan.FINAL_SEED)[0].seed
    begun.mkdir()

    class Pool(ProcessPoolExecutor):
        """What runs lasts until what waits has been cancelled, however busy the machine is."""

        def submit(self, *args):
            self.given = [*getattr(self, "given", []), super().submit(*args)]
            return self.given[-1]

        def shutdown(self, wait=True, *, cancel_futures=False):
            def release():
                while cancel_futures and not any(future.cancelled() for future in self.given):
                    time.sleep(0.01)
                ended.touch()

            Thread(target=release).start()
            super().shutdown(wait, cancel_futures=cancel_futures)

    monkeypatch.setattr(run, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(run.jobs, "work", partial(_failing, begun, ended, first))
    monkeypatch.setattr(run.jobs, "warm_up", lambda: None)
    with pytest.raises(RuntimeError, match="cannot be made"):
        run.main(["--only", "nothing=40", "--processes", "2", "--out", str(tmp_path / "score")])
    assert 1 <= len(list(begun.iterdir())) < 40
