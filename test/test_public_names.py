# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`import puma_sim_core as ps` gives the public names, and imports nothing heavy before one is used."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

import puma_sim_core as ps

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("numpy", "scipy", "numba", "yaml", "mcap", "rosbags", "matplotlib", "jinja2")


def modules_after(program: str) -> list[str]:
    """Heavy modules that a fresh interpreter has after a program."""
    program += f"; import json, sys; print(json.dumps([m for m in {HEAVY} if m in sys.modules]))"
    ran = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True)
    return json.loads(ran.stdout.splitlines()[-1])


def test_the_import_alone_is_light():
    assert modules_after("import puma_sim_core as ps; dir(ps)") == []


def test_a_name_is_imported_when_it_is_used():
    assert "numpy" in modules_after("import puma_sim_core as ps; ps.Plant")


@pytest.mark.parametrize("module", ["identify.explain", "appraisal.statistics", "tuning.estimation"])
def test_distributions_come_without_the_library_that_takes_half_a_second(module):
    program = f"import sys, puma_sim_core.{module}; print('scipy.stats' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True)
    assert ran.stdout == "False\n"


@pytest.mark.parametrize("name", ps.__all__)
def test_each_public_name_is_there_and_documented(name):
    assert (getattr(ps, name).__doc__ or "").strip()


def test_dir_shows_the_public_names_alone():
    assert dir(ps) == sorted(ps.__all__)
    assert not [name for name in dir(ps) if name.startswith("_")]


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'simulate_all'"):
        ps.simulate_all


def test_the_names_of_the_stub_are_public_and_stand_where_it_says():
    """Type checkers read the stub; the package must give the same objects."""
    tree = ast.parse((ROOT / "puma_sim_core" / "__init__.pyi").read_text(encoding="utf-8"))
    named = {
        alias.asname: getattr(importlib.import_module(entry.module), alias.name)
        for entry in tree.body
        if isinstance(entry, ast.ImportFrom)
        for alias in entry.names
    }
    assert set(named) == set(ps.__all__) and len(named) > 50
    assert all(getattr(ps, name) is value for name, value in named.items())
