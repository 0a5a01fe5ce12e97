# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The long runs of test/soak, a short while of each whose result is no matter of time."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from soak import fuzz, kills

pytestmark = pytest.mark.long


@pytest.mark.parametrize(("run", "count"), [(fuzz.run, 2000), (kills.run, 3)], ids=["fuzz", "kills"])
def test_a_short_while_of_a_long_run(run, count, tmp_path):
    lines = list(run(tmp_path, count, 3, False))
    assert lines and all(held for _, held in lines), lines
