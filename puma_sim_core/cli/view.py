# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Show a motion in the browser: the arm, its path, its setpoint, and plots beside it.

SOURCE is a session (the bag of a sim_node), the folder of a report of explain, whose log is shown beside the model
that was found, or a CSV with columns time, voltage1..n, position1..n, as explain reads it. The page is served on this
machine alone, until Ctrl-C; it asks nothing of a network. With --export it is written as one file instead.

  puma-sim view run.csv
  puma-sim view report
  puma-sim view log.csv --model report/model.yaml
  puma-sim view run.csv --export page.html

It needs the extra 'view': pip install 'puma_sim_ros[view]'.
"""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

from puma_sim_core.cli.arguments import (
    Command,
    add_columns_argument,
    add_source_arguments,
    column_names,
    positive_number,
    whole_number,
)
from puma_sim_core.cli.output import LOG, add_force_argument, check_input, check_output, output_file, start_at_once
from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    from puma_sim_core.view.motion import Motion


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("source", metavar="SOURCE", help="session, report of explain, or CSV")
    parser.add_argument(
        "--setpoints", metavar="FILE", help="CSV with time and setpoint1..n, such as a controller's log"
    )
    parser.add_argument("--export", metavar="FILE", help="write one HTML file that needs no network, and end")
    add_force_argument(parser)
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1: this machine alone)"
    )
    parser.add_argument("--port", metavar="N", help="port to listen on (default: the first free one from 8080 on)")
    parser.add_argument(
        "--restart", metavar="S", help="the model starts again from the log every S seconds (default 0.5)"
    )
    add_columns_argument(parser)
    parser.add_argument("--plant", metavar="NAME|FILE", help="machine of a CSV, as explain takes it (default puma560)")
    add_source_arguments(
        parser, "parameters of the arm of a CSV", "model file to show beside a log: what explain wrote"
    )


def run(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C, or write the page; raises the errors of the package."""
    check_input(options.source)
    if options.export is not None:
        inputs = [options.source, options.setpoints, options.model]
        check_output(options.export, [path for path in inputs if path is not None], force=options.force)
    port = None if options.port is None else whole_number(options.port, "--port", 0)

    from puma_sim_core.view.page import motion_page
    from puma_sim_core.view.player import Player
    from puma_sim_core.view.server import address, load_viser, serving

    load_viser()  # before the work
    motion = _motion(options)
    for note in motion.notes:
        LOG.info("note: %s", note)
    if options.export is not None:
        page = motion_page(motion)
        with output_file(options.export) as file:
            file.write(page)
        return 0
    with serving(options.host, port) as server:
        player = Player(server, motion)
        print(f"{address(server)} shows {motion.name}; Ctrl-C ends it", flush=True)
        player.run(lambda: False)
    return 0


def _motion(options: argparse.Namespace) -> Motion:
    """What there is to show; raises the errors of the package."""
    from puma_sim_core.identify.report.output import REPORT
    from puma_sim_core.plant.mechanism_file import load_mechanism
    from puma_sim_core.plant.model_file import load_model
    from puma_sim_core.view import sources

    source, columns = options.source, column_names(options.columns)
    interval = None if options.restart is None else positive_number(options.restart, "--restart")
    if os.path.exists(os.path.join(source, REPORT)) or os.path.basename(source) == REPORT:
        _only(options, "a report", "columns", "restart")
        start_at_once()
        motion = sources.report_motion(source, columns, interval)
    elif options.model is not None:
        _only(options, "--model", "model", "columns", "restart")
        start_at_once()
        motion = sources.log_motion(source, load_model(options.model), columns, interval)
    elif os.path.isdir(source) or source.endswith(".mcap"):
        _only(options, "a session without --model")
        motion = sources.session_motion(source)
    else:
        _only(options, "a CSV without --model", "columns", "plant", "parameters")
        machine = load_mechanism(options.plant or "puma560", parameters=options.parameters).plant()
        motion = sources.log_motion(source, machine, columns, compare=False)
    return motion if options.setpoints is None else sources.with_setpoints(motion, options.setpoints)


def _only(options: argparse.Namespace, what: str, *allowed: str) -> None:
    """Refuse options that say nothing about a source; raises ParameterError."""
    for name in ("model", "plant", "parameters", "columns", "restart"):
        if name not in allowed and getattr(options, name):
            expected = " or ".join(f"--{each}" for each in allowed) or "none of the machine's options"
            raise ParameterError(f"--{name} with {what}", where="view", expected=expected)


COMMAND = Command("view", "show a motion in the browser", __doc__, add_arguments, run)
