# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Speed beside other libraries; `puma-sim bench --help` lists the options."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

NAME = "bench"
SUMMARY = "measure the speed beside other libraries"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """None: all that stands behind the name goes to `puma_sim_core.bench`, unseen by argparse."""


def run_arguments(arguments: Sequence[str]) -> int:
    """Measure and print; returns the exit status."""
    from ..bench.__main__ import main

    return main(arguments)


def run(options: argparse.Namespace) -> int:
    """`run_arguments` without any."""
    return run_arguments([])
