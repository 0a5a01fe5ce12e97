# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The demonstration of `make run`, again and again."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

from ros_support import ROOT, environment

from soak.machine import ColdCache


def run(folder: Path, count: int, _seed: int, cold: bool) -> Iterator[tuple[str, bool]]:
    """Run it `count` times; a line for each."""
    for number in range(count):
        cache = ColdCache(folder / f"cache{number}") if cold else None
        variables = cache.variables if cache else {"PUMA_SIM_KERNEL": "auto"}
        began = time.monotonic()
        with cache or nullcontext():
            done = subprocess.run(
                [sys.executable, ROOT / "examples" / "sessions" / "line.py", "--out", folder / f"out{number}"],
                env={**environment(), **variables},
                text=True,
                capture_output=True,
            )
        held = done.returncode == 0 and "replay identical" in done.stdout
        lines = [line for line in done.stdout.splitlines() if line.startswith(("steps", "lateness"))]
        words = "; ".join(lines if held else [done.stdout, done.stderr])
        yield f"{time.monotonic() - began:.1f} s: {words}", held
