# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Merge what the shards of a command wrote, and make its table: the same bytes as without shards.

  puma-sim merge reports                            all shards wrote into one folder
  puma-sim merge part1 part2 part3 --out reports    each into its own

Of `explain-many` and of `appraise`, whose folder then has the whole report.

All shards must be finished, and of one and the same command. A folder that holds the results of anything else is
refused; the table or report of the same run is written anew.
"""

from __future__ import annotations

import argparse
import os

from puma_sim_core.cli.arguments import Command
from puma_sim_core.errors import ParameterError, RecordingError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folders", metavar="DIR", nargs="+", help="folder that one shard, or all, wrote")
    parser.add_argument("--out", metavar="DIR", help="folder of all; may be left out where there is one DIR")


def run(options: argparse.Namespace) -> int:
    """Merge, and print as the command without shards does."""
    from puma_sim_core.cli.appraise import merge_shards
    from puma_sim_core.cli.identify.explain_many import COMMAND_NAME, print_table
    from puma_sim_core.result_folder import ResultFolder, merged

    if options.out is None and len(options.folders) > 1:
        raise ParameterError("no --out", where="merge", expected="--out DIR for what several folders have")
    real = list(map(os.path.realpath, options.folders))
    for path in options.folders:
        if real.count(os.path.realpath(path)) > 1:
            raise ParameterError("stands twice", where=path, expected="each folder once")
    out = options.out or options.folders[0]
    command = ResultFolder.opened(options.folders[0]).run["command"]
    if command == "appraise":
        return merge_shards(options.folders, out)
    if command != COMMAND_NAME:
        what, expected = f"is of `{command}`", f"a folder of {COMMAND_NAME} or appraise"
        raise RecordingError(what, where=options.folders[0], expected=expected)
    print_table(merged(options.folders, out))
    return 0


COMMAND = Command("merge", "merge what the shards of a command wrote", __doc__, add_arguments, run)
