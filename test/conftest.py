# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`--share n/m`: the n-th of m shares of the tests that one interpreter is enough for, about equally long.

These are the long tests, and the quick ones of files of which they take ten seconds or more. Interpreters that run side
by side share them out: their numbers are the same on any. All other quick tests are in each share. The tests of a file
stay together, since they may share what it took long to make.
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

#: seconds that the long tests of a file took, thorough ones left out, when last measured (2026-11-30), where many
LONG = {
    "test_docs": 208,
    "test_ros_appraise": 158,
    "test_ros2_cli": 78,
    "test_explain_many": 76,
    "test_loop_blind": 58,
    "test_identify_invariance": 54,
    "test_ros_loop_demo": 50,
    "test_loop_rigs": 43,
    "test_cli_simulate": 42,
    "test_appraise": 40,
    "test_loop_gate": 38,
    "test_bag_recovery": 35,
    "test_loop_held_out": 31,
    "test_loop_cuts": 22,
    "test_ros_first_hour": 31,
    "test_ros_soak": 27,
    "test_view_browser": 24,
    "test_rigs": 23,
    "test_thesis_chapter_5_6": 22,
    "test_ros_foreign": 20,
    "test_thesis_chapter_7_7": 19,
    "test_loop_impossible": 19,
    "test_late_stamps": 18,
    "test_thesis_report": 16,
    "test_identification": 16,
    "test_bag_split": 15,
    "test_loop_elimination": 15,
    "test_thesis_chapter_7_9_8": 15,
    "test_thesis_chapter_7_open": 14,
}
#: of each other file, in the mean
LONG_OTHERWISE = 6
#: files whose quick tests take two seconds or more, but for those of the kernel, its laws and the recordings
QUICK = {
    "test_appraisal_margins",
    "test_appraisal_statistics",
    "test_appraise",
    "test_bag_split",
    "test_bench",
    "test_cli_bags",
    "test_cli_commands",
    "test_cli_explain",
    "test_coarse_clock",
    "test_compiling",
    "test_docs",
    "test_effect_library",
    "test_errata",
    "test_excite",
    "test_executors",
    "test_explain_many",
    "test_link_side",
    "test_loop_agreement",
    "test_loop_cuts",
    "test_loop_elsewhere",
    "test_loop_overview",
    "test_loop_report",
    "test_loop_shapes",
    "test_loop_surrogates",
    "test_loop_undriven",
    "test_machines",
    "test_mechanisms",
    "test_one_by_one",
    "test_packaging",
    "test_pages",
    "test_public_names",
    "test_rigid_body",
    "test_ros_appraise",
    "test_ros_bag_publisher",
    "test_ros_commands",
    "test_ros_controllers",
    "test_ros_demo",
    "test_ros_errors",
    "test_ros_first_hour",
    "test_ros_lockstep",
    "test_ros_realtime",
    "test_ros_startup",
    "test_ros_trajectory",
    "test_ros_user_effects",
    "test_shares",
    "test_side_by_side",
    "test_thesis_report",
    "test_third_order",
    "test_user_effects",
    "test_ziegler_nichols",
}


def pytest_addoption(parser):
    parser.addoption(
        "--share",
        default=(1, 1),
        metavar="N/M",
        type=_share,
        help="the N-th of M shares of the tests that one interpreter is enough for",
    )
    parser.addoption(
        "--ahead",
        default=(),
        metavar="S,...",
        type=_seconds,
        help="seconds that the process of each share has other work to do before",
    )


def _share(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    number, of = map(int, found.groups()) if found else (0, 0)
    if not 1 <= number <= of:
        raise pytest.UsageError(f"--share {text}: expected N/M with 1 <= N <= M")
    return number, of


def _seconds(text: str) -> tuple[float, ...]:
    try:
        return tuple(map(float, text.split(",")))
    except ValueError:
        raise pytest.UsageError(f"--ahead {text}: expected seconds with commas between them") from None


def pytest_collection_modifyitems(config, items):
    number, of = config.getoption("--share")
    long = {item: any(item.get_closest_marker(mark) for mark in ("long", "thorough")) for item in items}
    ahead = config.getoption("--ahead") or of * (0.0,)
    if len(ahead) != of:
        raise pytest.UsageError(f"--ahead has {len(ahead)} shares, --share {of}; expected as many")
    shares = _shared_out({item.path.stem for item in items if long[item]}, ahead)
    for item in items:
        if item.path.stem in QUICK and not long[item]:
            # of tests of nodes each interpreter has some; the others go where the lines are counted that tests reach
            shares[item.path.stem, False] = 1 if _of_nodes(item.path.stem) else of
    left = [item for item in items if shares.get((item.path.stem, long[item]), number) != number]
    if left:
        config.hook.pytest_deselected(items=left)
        others = {id(item) for item in left}
        items[:] = [item for item in items if id(item) not in others]


def _of_nodes(file: str) -> bool:
    return file.startswith("test_ros")


def _shared_out(files: set[str], ahead: tuple[float, ...]) -> dict[tuple[str, bool], int]:
    """The share of each file with long tests: those of nodes and of the thesis, which have lines of their own, to the
    last, the others from the longest on, each to the share that has least so far. ahead [s] : what each has before."""
    taken, shares = list(ahead), len(ahead)
    found = {}
    last = {file for file in files if _of_nodes(file) or file.startswith("test_thesis")}
    for file in sorted(files, key=lambda name: (name not in last, -LONG.get(name, LONG_OTHERWISE), name)):
        least = shares - 1 if file in last else taken.index(min(taken))
        taken[least] += LONG.get(file, LONG_OTHERWISE)
        found[file, True] = least + 1
    return found
