# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`--share n/m`: of the files with tests that are marked long, every m-th from the n-th on.

Two interpreters that run side by side share these tests out: their numbers are the same on any.
Those of a file stay together, since they may share what it took long to make.
"""

from __future__ import annotations

import re

import pytest
from hypothesis import settings

# how long an example takes says nothing on a machine that does other work as well; each run takes the same examples
settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")


def pytest_addoption(parser):
    parser.addoption(
        "--share",
        default=(1, 1),
        metavar="N/M",
        type=_share,
        help="of the files with tests marked long, every M-th from the N-th on",
    )


def _share(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    number, of = (int(part) for part in found.groups()) if found else (0, 0)
    if not 1 <= number <= of:
        raise pytest.UsageError(f"--share {text}: expected N/M with 1 <= N <= M")
    return number, of


def pytest_collection_modifyitems(config, items):
    number, of = config.getoption("--share")
    long = [item for item in items if item.get_closest_marker("long")]
    files = sorted({item.path for item in long})[number - 1 :: of]
    others = {id(item) for item in long if item.path not in files}
    left = [item for item in items if id(item) in others]
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if id(item) not in others]
