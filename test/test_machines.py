# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Simulated logs of other machines: draws that come again, and marks of their answers."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from machines import judging, run
from machines.records import MACHINES, OTHERS, Record

from puma_sim_core.effects import KINDS
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.settings import SELECTION

RUBS, PULLS, TWO = ("coulomb_friction", 1), ("voltage_offset", 1), ("asymmetric_coulomb_friction", 1)
LAG, DELAY = ("sensor_lag", 1), ("input_delay", None)
MUCH = 2.0 * SELECTION.least_gain


@pytest.mark.parametrize(
    "said, verdict, true, behind, mark",
    [
        ([], "NOTHING_MISSING", [], None, judging.RIGHT),
        ([], "UNNAMED", [], None, judging.ALARM),
        ([RUBS], "NAMED", [], None, judging.ALARM),
        ([RUBS, LAG], "NAMED", [LAG, RUBS], None, judging.RIGHT),
        ([TWO], "NAMED", [RUBS, PULLS], MUCH, judging.ALIKE),
        ([RUBS, PULLS], "NAMED", [TWO], MUCH, judging.ALIKE),
        ([RUBS, LAG], "NAMED", [RUBS], MUCH, judging.NEEDLESS),
        ([RUBS, DELAY], "NAMED_WITH_REMAINDER", [RUBS, LAG], MUCH, judging.MISSED),
        ([RUBS], "NAMED", [RUBS, LAG], None, judging.MISSED),
        ([RUBS], "NAMED", [RUBS, LAG], 0.5 * SELECTION.least_gain, judging.HIDDEN),
        ([RUBS], "NAMED", [("coulomb_friction", 2)], MUCH, judging.MISSED),
        ([], "DATA_FAULT", [RUBS], None, judging.FAULT),
    ],
)
def test_marks_of_answers(said, verdict, true, behind, mark):
    assert judging.judged(said, verdict, true, behind) == mark


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    name = "qube_pendulum"
    first, again, other = (Record(seed, name).write(tmp_path / folder) for seed, folder in _folders(tmp_path))
    assert first.read_bytes() == again.read_bytes() != other.read_bytes()


def _folders(path):
    for seed, name in ((3, "a"), (3, "b"), (4, "c")):
        (path / name).mkdir()
        yield seed, name


@pytest.mark.parametrize("name", MACHINES)
def test_each_machine_may_have_all_that_its_drive_train_can(name):
    record, rng, refused = Record(5, name), np.random.default_rng(1), set()
    for other in OTHERS:
        try:
            effect = record.drawn(rng, record.driven[0], other)
        except ParameterError:
            refused.add(other)
            continue
        assert effect.kind.name == other and effect.joint in (record.driven[0] + 1, None)
        # such as machines have, but for a limit, which is drawn by what the motion asks for
        if other != "voltage_saturation":
            sizes = {key: size for key, size in effect.values.items() if key in ("torque", "voltage", "gap", "mass")}
            spans = {key: record.mechanism.plausible(effect.kind.parameter(key), record.driven[0]) for key in sizes}
            assert all(span[0] <= abs(sizes[key]) <= span[1] for key, span in spans.items())
    # without a rotor of its own a joint has no transmission
    assert refused <= ({"backlash", "joint_elasticity"} if name == "slide" else set())


def test_true_parameters_are_within_their_priors():
    records = [Record(seed) for seed in range(28)]
    assert {record.name for record in records} == set(MACHINES)
    for record in records:
        far = np.abs(record.theta - record.mechanism.start) / record.mechanism.deviations
        assert far.max() < 1.3 and np.isfinite(record.goal).all()
        rubs = [effect.joint for effect in record.effects if effect.kind.dry]
        assert len(rubs) == len(set(rubs))


@pytest.mark.long
def test_a_record_is_explained_and_marked(tmp_path, capsys):
    seed = next(seed for seed in range(100) if Record(seed, "dfki_pendulum").kind == "friction")
    given = ["--only", "dfki_pendulum", "--seed", str(seed), "--count", "1", "--processes", "1", "--out", str(tmp_path)]
    assert run.main(given) == 0
    text = capsys.readouterr().out
    assert f"{seed} dfki_pendulum: coulomb_friction@1 -> NAMED: coulomb_friction@1: right" in text
    assert "| dfki_pendulum | 1 | 1 |" in text
    kept = (tmp_path / "outcomes.jsonl").read_text()
    assert json.loads(kept)["mark"] == judging.RIGHT
    # an outcome that is there is not made again
    assert run.main(given) == 0
    assert (tmp_path / "outcomes.jsonl").read_text() == kept


@pytest.mark.long
def test_a_model_without_what_is_there_is_behind(tmp_path):
    seed = next(seed for seed in range(100) if Record(seed, "dfki_pendulum").kind == "friction")
    record = Record(seed, "dfki_pendulum")
    path, m = record.write(tmp_path), record.mechanism
    assert [effect.kind for effect in record.effects] == [KINDS["coulomb_friction"]]
    numbers = {p.name: (0.0, value, "", 1.0) for p, value in zip(m.free, m.start)}

    def behind(effects):
        found = SimpleNamespace(
            effects=[SimpleNamespace(name=e.kind.name, joint=e.joint) for e in effects],
            model=m.plant(m.start, effects),
            parameters=numbers,
        )
        return judging.behind(path, m, record.theta, record.effects, found)

    assert behind(()) > 100.0
    assert behind(record.effects) == pytest.approx(0.0, abs=1.0)
