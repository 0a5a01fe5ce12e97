# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The command `puma-sim`. Each subcommand has its file; here they come together.

The files declare their options with nothing but argparse, and import the model when they run:
with numba that takes a second, which a call for help need not wait.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence

from puma_sim_core import __version__
from puma_sim_core.cli import excite, explain, identify_controller, listing, records, simulate, thesis, tune
from puma_sim_core.errors import PumaSimError

COMMANDS = (
    *(simulate.COMMAND, explain.COMMAND, excite.COMMAND, records.REPLAY, records.RECOVER, listing.COMMAND),
    *(records.MODEL, thesis.COMMAND, tune.COMMAND, identify_controller.COMMAND),
)
#: a value such as -0.1,0,0, which argparse would take for an option
_NEGATIVE = re.compile(r"-\.?[0-9]")


def parser() -> argparse.ArgumentParser:
    """The command line of all subcommands."""
    top = argparse.ArgumentParser(
        prog="puma-sim",
        allow_abbrev=False,
        description="The first three joints of the PUMA 560 with their motors, simulated.",
    )
    top.add_argument("--version", action="version", version=f"puma-sim {__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        sub = commands.add_parser(
            command.name,
            help=command.summary,
            description=command.description,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_arguments(sub)
        sub.add_argument(
            "--effects",
            metavar="FILE",
            action="append",
            default=[],
            help="a Python file with an effect of your own; may be repeated",
        )
        sub.set_defaults(run=command.run)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status.

    0 for success, 1 for a replay that differs, 2 for input that cannot be used (one line on
    standard error says what, where, and what was expected), 130 after Ctrl-C, 141 where the
    reader of the output went away. A wrong command line ends by SystemExit(2), as argparse does.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    options = parser().parse_args(_with_equals(arguments))
    return _guarded(lambda: _run(options))


def _run(options: argparse.Namespace) -> int:
    if options.effects:
        from puma_sim_core.effects import load_effects

        load_effects(options.effects)
    return int(options.run(options))


def _with_equals(arguments: Sequence[str]) -> list[str]:
    """``--option -1,2`` as ``--option=-1,2``."""
    joined: list[str] = []
    for argument in arguments:
        before = joined[-1] if joined else ""
        if _NEGATIVE.match(argument) and before.startswith("--") and "=" not in before:
            joined[-1] = f"{before}={argument}"
        else:
            joined.append(argument)
    return joined


def _guarded(run: Callable[[], int]) -> int:
    """The status of a command, whatever ended it."""
    try:
        status = run()
        sys.stdout.flush()
        return status
    except PumaSimError as error:
        # one line, whatever text of another library is in it
        print(f"puma-sim: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # Python flushes standard output at its end and would complain
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
