# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`--share`: interpreters side by side run each test, and what one is enough for once."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from conftest import LONG, QUICK

TESTS = Path(__file__).resolve().parent
FILE = """
import pytest

def test_quick(): pass

@pytest.mark.long
def test_long(): pass

@pytest.mark.thorough
def test_thorough(): pass
"""
#: quick ones for all, for one as their file takes long, and of nodes
FILES = ("test_a", "test_b", "test_thesis_a", "test_ros_a", "test_loop_report", "test_thesis_report", "test_ros_demo")


def collected(folder: Path, *options: str) -> Counter:
    """The tests that are chosen, and how often."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--collect-only", "-p", "no:cacheprovider", *options, str(folder)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(TESTS)},
        capture_output=True,
        text=True,
    )
    assert done.returncode in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED), done.stdout + done.stderr
    return Counter(line.strip() for line in done.stdout.splitlines() if "::" in line)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("tests")
    (made / "conftest.py").write_text((TESTS / "conftest.py").read_text(encoding="utf-8"))
    marks = "".join(f"    {mark}: of this project\n" for mark in ("long", "thorough"))
    (made / "pytest.ini").write_text(f"[pytest]\nmarkers =\n{marks}")
    for name in FILES:
        (made / f"{name}.py").write_text(FILE)
    return made


@pytest.mark.parametrize("shares", [1, 2, 3])
def test_each_test_is_in_a_share_and_what_takes_long_in_one(folder, shares):
    every = collected(folder)
    assert len(every) == 3 * len(FILES)
    found = sum((collected(folder, "--share", f"{n}/{shares}") for n in range(1, shares + 1)), Counter())
    assert set(found) == set(every)
    for test, times in found.items():
        file, name = Path(test.partition("::")[0]).stem, test.rpartition("::")[2]
        once = name != "test_quick" or file in QUICK
        assert times == (1 if once else shares), test


def test_a_share_whose_process_has_other_work_before_gets_less(folder):
    """Of files of a length the one that begins late gets none, unless the others have more by then."""
    long = ("-m", "long", "--ahead", "0,20,0")
    found = [collected(folder, *long, "--share", f"{n}/3") for n in (1, 2, 3)]
    assert sum(found, Counter()) == collected(folder, "-m", "long") and not found[1]
    assert collected(folder, "-m", "long", "--ahead", "20,0,20", "--share", "2/3")


@pytest.mark.parametrize(
    "options, words",
    [
        (["--share", "0/2"], "expected N/M with 1 <= N <= M"),
        (["--share", "3/2"], "expected N/M with 1 <= N <= M"),
        (["--share", "half"], "expected N/M with 1 <= N <= M"),
        (["--share", "1/2", "--ahead", "0,1,2"], "--ahead has 3 shares, --share 2; expected as many"),
        (["--share", "1/2", "--ahead", "0;1"], "--ahead 0;1: expected seconds with commas between them"),
    ],
)
def test_a_share_that_cannot_be_is_refused(folder, options, words):
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--collect-only", *options, str(folder)],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0 and words in done.stdout + done.stderr


def test_files_that_take_long_are_files_of_the_tests():
    assert set(LONG) | QUICK <= {path.stem for path in TESTS.glob("test_*.py")}
