# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Draw a log: positions, tracking error, voltages and currents over time, as far as it has them.

SOURCE is a CSV, as simulate writes it and explain reads it, or a session (the bag of a sim_node). Without --out the
picture is SOURCE's name with .png, in the present folder.

  puma-sim plot run.csv
  puma-sim plot pendulum.csv --plant pendulum --out pendulum.svg
  puma-sim plot build/demo/bag --out session.pdf
"""

from __future__ import annotations

import argparse
import os

from puma_sim_core.cli.arguments import Command, add_columns_argument, column_names
from puma_sim_core.cli.output import LOG, add_force_argument, check_input, check_output
from puma_sim_core.errors import ParameterError

#: kinds of pictures, by the ending of the file
_KINDS = (".png", ".svg", ".pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("source", metavar="SOURCE", help="CSV or session")
    parser.add_argument("--out", metavar="FILE", help=f"picture to write: {', '.join(_KINDS)} (default SOURCE.png)")
    add_force_argument(parser)
    parser.add_argument("--setpoints", metavar="FILE", help="CSV with time and setpoint1..n")
    add_columns_argument(parser)
    parser.add_argument("--plant", metavar="NAME|FILE", help="machine of a CSV, as explain takes it (default puma560)")


def run(options: argparse.Namespace) -> int:
    """Read and draw; raises the errors of the package."""
    check_input(options.source)
    out = options.out or f"{os.path.splitext(os.path.basename(os.path.abspath(options.source)))[0]}.png"
    kind = os.path.splitext(out)[1].lower()
    if kind not in _KINDS:
        raise ParameterError(f"'{out}'", where="--out", expected=f"a name that ends in {' or '.join(_KINDS)}")
    inputs = [path for path in (options.source, options.setpoints, options.plant) if path is not None]
    check_output(out, inputs, force=options.force)

    from puma_sim_core.pages.drawing import save
    from puma_sim_core.plant.mechanism_file import load_mechanism
    from puma_sim_core.view import sources

    if os.path.isdir(options.source) or options.source.endswith(".mcap"):
        for name in ("plant", "columns"):
            if getattr(options, name):
                raise ParameterError(f"--{name} with a session", where="plot", expected="none: a session has its own")
        motion = sources.session_motion(options.source)
    else:
        machine = load_mechanism(options.plant or "puma560").plant()
        motion = sources.log_motion(options.source, machine, column_names(options.columns), compare=False, drawn=False)
    if options.setpoints is not None:
        motion = sources.with_setpoints(motion, options.setpoints)
    for note in motion.notes:
        LOG.info("note: %s", note)
    save(motion.figures(), out)
    LOG.info(out)
    return 0


COMMAND = Command("plot", "draw a log as a picture", __doc__, add_arguments, run)
