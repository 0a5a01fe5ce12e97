# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the priors of the parameters ask for, and no row says anything of."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest
from report_checks import contradictions

from puma_sim_core.identify import explain
from puma_sim_core.identify.report.json import report_text

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
import make_logs


def explained(effects, seed: int, folder: Path):
    """The explanation of 10 s of an arm whose parameters differ from the published ones by some per cent."""
    path = folder / "log.csv"
    make_logs.write(path, *make_logs.record("puma560", effects, seed, **make_logs.ARM))
    return explain(path)


@pytest.mark.thorough
def test_a_payload_that_other_links_could_replace_is_named(tmp_path):
    """Links 5 deviations of their priors away predict as well: it was taken back, and a curve was left."""
    found = explained(("payload:mass=1.5",), 12, tmp_path)
    assert (found.verdict, [(e.name, e.joint) for e in found.effects]) == ("NAMED", [("payload", None)])
    mass = found.effects[0].parameters["mass"]
    assert 0.0 < mass.low < 1.5 < mass.high
    assert re.search(r"without it parameters would be up to [3-7]\.\d standard deviations of", found.sentence)
    assert "stays at" in found.sentence
    assert contradictions(json.loads(report_text(found))) == []


@pytest.mark.long
def test_links_that_differ_by_some_per_cent_are_no_payload(tmp_path):
    found = explained((), 12, tmp_path)
    assert (found.verdict, found.effects) == ("NOTHING_MISSING", ())
