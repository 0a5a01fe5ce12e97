# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`--share n/m`: the n-th of m shares of the files with tests that are marked long, about equally long; `n,k/m` the
n-th and the k-th.

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

#: files whose long tests take longest, the longest first: they are dealt out first, to and fro
LONGEST = (
    "test_loop_blind",
    "test_docs",
    "test_user_effects",
    "test_thesis_report",
    "test_loop_rest",
    "test_loop_rigs",
    "test_explain_many",
    "test_ros_loop_demo",
    "test_loop_shapes",
    "test_excite",
    "test_ros2_cli",
    "test_loop_fits",
)


def pytest_addoption(parser):
    parser.addoption(
        "--share",
        default=((1,), 1),
        metavar="N[,K...]/M",
        type=_share,
        help="the N-th (and the K-th, ...) of M shares of the files with tests marked long",
    )


def _share(text: str) -> tuple[tuple[int, ...], int]:
    found = re.fullmatch(r"(\d+(?:,\d+)*)/(\d+)", text)
    numbers, of = (tuple(map(int, found[1].split(","))), int(found[2])) if found else ((0,), 0)
    if not all(1 <= number <= of for number in numbers):
        raise pytest.UsageError(f"--share {text}: expected N/M with 1 <= N <= M, or N,K/M")
    return numbers, of


def pytest_collection_modifyitems(config, items):
    numbers, of = config.getoption("--share")
    long = [item for item in items if item.get_closest_marker("long")]
    order = {name: place for place, name in enumerate(LONGEST)}
    files = sorted({item.path for item in long}, key=lambda path: (order.get(path.stem, len(order)), path))
    turns = [*range(1, of + 1), *range(of, 0, -1)]
    others = {id(item) for item in long if turns[files.index(item.path) % len(turns)] not in numbers}
    left = [item for item in items if id(item) in others]
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if id(item) not in others]
