# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Read what a killed recorder left of a bag, and write it as a closed bag beside it.

All whole periods are kept, with the commands that a written state shows. The original is not
touched.
"""

from __future__ import annotations

import argparse

NAME = "recover"
SUMMARY = "close the bag of a recorder that was killed"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("bag", metavar="BAG", help="the bag's directory or its .mcap file")
    parser.add_argument("--out", metavar="DIR", help="the bag to make (default: BAG with _recovered behind its name)")


def run(options: argparse.Namespace) -> int:
    """Recover and say what was there; raises BagError."""
    from puma_sim_core.recording.bag import recover

    found = recover(options.bag, options.out)
    whole = ", all of it: the original was closed" if found.was_complete else ""
    print(f"{found.path}: {found.steps} steps, {found.last_time_ns * 1e-9:.3f} s{whole}")
    return 0
