# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The command `puma-sim`. Each subcommand has its file; here they come together.

The files declare their options with nothing but argparse, and import the model when they run:
with numba that takes a second, which a call for help need not wait.
"""

import argparse
import contextlib
import os
import re
import sys
import traceback
from collections.abc import Callable, Sequence

from puma_sim_core import __version__
from puma_sim_core.cli import appraise, listing, merge, plot, records, simulate, thesis, tune, view
from puma_sim_core.cli.identify import excite, explain, explain_many, identify_controller, mechanism
from puma_sim_core.cli.output import LOG, reporting
from puma_sim_core.cli.parser import Parser
from puma_sim_core.errors import PumaSimError

COMMANDS = (
    *(
        simulate.COMMAND,
        explain.COMMAND,
        explain_many.COMMAND,
        merge.COMMAND,
        excite.COMMAND,
        records.REPLAY,
        records.RECOVER,
        listing.COMMAND,
    ),
    plot.COMMAND,
    *(mechanism.COMMAND, records.MODEL, thesis.COMMAND, tune.COMMAND, identify_controller.COMMAND, appraise.COMMAND),
    view.COMMAND,
)
#: a value such as -0.1,0,0, which argparse would take for an option
_NEGATIVE = re.compile(r"-\.?[0-9]")


def parser() -> argparse.ArgumentParser:
    """The command line of all subcommands."""
    top = Parser(prog="puma-sim", description="The first three joints of the PUMA 560 with their motors, simulated.")
    top.add_argument("--version", action="version", version=f"puma-sim {__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        sub = commands.add_parser(command.name, help=command.summary, description=command.description)
        command.add_arguments(sub)
        sub.add_argument(
            "--effects",
            metavar="FILE",
            action="append",
            default=[],
            help="a Python file with an effect of your own; may be repeated",
        )
        words = sub.add_mutually_exclusive_group()
        words.add_argument("--quiet", action="store_true", help="nothing on standard error but warnings and errors")
        words.add_argument(
            "--verbose", action="store_true", help="also say which versions run, progress each second, traces of errors"
        )
        sub.set_defaults(run=command.run)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status.

    0 for success, 1 for a replay that differs or a job without a result, 2 for input that cannot be used (one line on
    standard error says what, where, and what was expected), 3 for a log that `explain` read and cannot use, 130 after
    Ctrl-C, 141 where the reader of the output went away. A wrong command line ends by SystemExit(2), as argparse does.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    top = parser()
    _complete(top)
    options = top.parse_args(_with_equals(arguments))
    with reporting(options.quiet, options.verbose):
        return _guarded(lambda: _run(options), options.verbose)


def _complete(top: argparse.ArgumentParser) -> None:
    """Answer a shell that asks how a line goes on, where argcomplete (the extra `completion`) is installed."""
    if "_ARGCOMPLETE" in os.environ:
        with contextlib.suppress(ImportError):
            import argcomplete

            argcomplete.autocomplete(top)


def _run(options: argparse.Namespace) -> int:
    if options.verbose:
        _say_versions()
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


def _say_versions() -> None:
    """What runs, for a report of a fault."""
    import numpy

    from puma_sim_core.jit import BACKEND

    python, kernel = ".".join(map(str, sys.version_info[:3])), BACKEND
    LOG.debug("puma-sim %s, Python %s, NumPy %s, %s kernel", __version__, python, numpy.__version__, kernel)


def _guarded(run: Callable[[], int], verbose: bool = False) -> int:
    """The status of a command, whatever ended it."""
    try:
        status = run()
        sys.stdout.flush()
        return status
    except PumaSimError as error:
        if verbose:
            traceback.print_exc()
        # one line, whatever text of another library is in it
        print(f"puma-sim: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # Python flushes standard output at its end and would complain
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
