# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`--share n/m`: the n-th of m shares of the files with tests that are marked long, about equally long.

Two interpreters that run side by side share these tests out: their numbers are the same on any.
Those of a file stay together, since they may share what it took long to make.
"""

from __future__ import annotations

import re
import signal

import pytest
from hypothesis import settings

# what these find wrong is shown as what a test finds
pytest.register_assert_rewrite("browser_support", "ros_support")

# how long an example takes says nothing on a machine that does other work as well; each run takes the same examples
settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")

# a shell's background job ignores Ctrl-C, and so would all programs that tests start and interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)
# and behind nohup a hangup; a handler of Python's is none in the programs that are started
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)

#: seconds of a processor that the long tests of a file took when they were last measured (2026-11-27), where many
LONG = {
    "test_loop_blind": 233,
    "test_docs": 196,
    "test_thesis_report": 109,
    "test_explain_many": 104,
    "test_user_effects": 102,
    "test_loop_rest": 90,
    "test_ros2_cli": 67,
    "test_loop_rigs": 64,
    "test_ros_loop_demo": 61,
    "test_ros_appraise": 58,
    "test_loop_shapes": 55,
    "test_excite": 45,
    "test_loop_fits": 36,
    "test_identify_invariance": 32,
    "test_appraise": 32,
}
#: of each other file, in the mean
LONG_OTHERWISE = 10


def pytest_addoption(parser):
    parser.addoption(
        "--share",
        default=(1, 1),
        metavar="N/M",
        type=_share,
        help="the N-th of M shares of the files with tests marked long",
    )


def _share(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    number, of = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= of:
        raise pytest.UsageError(f"--share {text}: expected N/M with 1 <= N <= M")
    return number, of


def pytest_collection_modifyitems(config, items):
    number, of = config.getoption("--share")
    long = [item for item in items if item.get_closest_marker("long")]
    share = _shared_out({item.path.stem for item in long}, of)
    left = [item for item in long if share[item.path.stem] != number]
    if left:
        config.hook.pytest_deselected(items=left)
        others = {id(item) for item in left}
        items[:] = [item for item in items if id(item) not in others]


def _shared_out(files: set[str], shares: int) -> dict[str, int]:
    """The share of each file: the longest first, each to the share that has least so far."""
    taken = [0] * shares
    found = {}
    for file in sorted(files, key=lambda name: (-LONG.get(name, LONG_OTHERWISE), name)):
        least = taken.index(min(taken))
        taken[least] += LONG.get(file, LONG_OTHERWISE)
        found[file] = least + 1
    return found
