# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Write voltages that tell effects apart, or that show one.

  puma-sim excite --separate ONE,OTHER --joint 2 --out volts.csv
  puma-sim excite --separate ONE,OTHER@3 --seconds 20 --out volts.csv
  puma-sim excite --plant pendulum --separate ONE --out volts.csv

Out: columns time, voltage1..n [s, V]; the voltages of a row hold until the next row. Lines at the
top say what it was made for, and the pose in which the machine has to start, at rest. Played in
open loop they lead the start model along a motion within the ranges of the joints, the greatest
speeds and voltages; so they do if its parameters are wrong by 8 %, with some drift. Standard error
gets what to expect: the gain of log evidence [nat] of the effect that is there.

Feed the log of it back to `puma-sim explain`, best together with the log that left the question.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from puma_sim_core.cli.arguments import Command, add_mechanism_arguments, number, positive_number, whole_number
from puma_sim_core.cli.output import LOG, Progress, add_force_argument, check_output, output_file, start_at_once
from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    import numpy as np

    from puma_sim_core.identify.experiment.design import Design
    from puma_sim_core.plant.mechanism import Mechanism


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--separate", metavar="A[,B...]", required=True, help="effects (`puma-sim list`), each as NAME or NAME@JOINT"
    )
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV of voltages to write; - for standard output")
    parser.add_argument(
        "--setpoints",
        metavar="FILE",
        help="also write the motion as columns time, setpoint1..n, for a machine "
        "that is to follow it under its own controller",
    )
    add_force_argument(parser)
    parser.add_argument("--joint", metavar="J", help="joint of effects that name none")
    parser.add_argument("--seconds", metavar="S", default="10", help="length of the record (10)")
    parser.add_argument("--rate", metavar="HZ", help="rows a second (1071.43: the servo period of 28/30 ms)")
    parser.add_argument(
        "--max-voltage",
        metavar="V",
        help="greatest voltage (40 for an arm; of a single joint ten times that of its nominal friction)",
    )
    parser.add_argument(
        "--max-velocity", metavar="W", help="greatest speed of a joint [rad/s or m/s] (0.6 of its range a second)"
    )
    add_mechanism_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Search, write, and tell what to expect; raises the errors of the package."""
    seed = whole_number(options.seed, "--seed", 0)
    joint = None if options.joint is None else whole_number(options.joint, "--joint", 1)
    seconds = number(options.seconds, "--seconds")
    greatest = {
        name: None if (text := getattr(options, name)) is None else positive_number(text, f"--{name.replace('_', '-')}")
        for name in ("max_voltage", "max_velocity", "rate")
    }
    inputs = [path for path in (options.plant, options.parameters, options.model) if path is not None]
    check_output(options.out, inputs, force=options.force)
    if options.setpoints is not None:
        check_output(options.setpoints, inputs, force=options.force)
        if options.setpoints == options.out:
            raise ParameterError(f"'{options.out}' twice", where="--setpoints", expected="another file than --out")

    from puma_sim_core.identify.experiment.design import design, suspects_of
    from puma_sim_core.identify.experiment.excitation import Limits
    from puma_sim_core.identify.settings import SELECTION
    from puma_sim_core.plant.mechanism_file import load_mechanism
    from puma_sim_core.simulation.simulator import SERVO_PERIOD

    mechanism = load_mechanism(options.plant, parameters=options.parameters, model=options.model)
    suspects = suspects_of(options.separate.split(","), mechanism, joint)
    limits = Limits.of(mechanism, greatest["max_voltage"], greatest["max_velocity"])
    start_at_once(patient=True)
    with Progress() as shown:
        found = design(
            mechanism,
            suspects,
            seconds=seconds,
            seed=seed,
            limits=limits,
            rate=greatest["rate"] or 1.0 / SERVO_PERIOD,
            progress=shown,
        )
        head = _head(found, mechanism, options)
        _write(options.out, head, found.time, "voltage", found.voltage)
        if options.setpoints is not None:
            _write(options.setpoints, head, found.time, "setpoint", found.setpoint)
    if found.nats < SELECTION.least_gain:
        least = f"{found.nats:.2g} nat are less than a name takes ({SELECTION.least_gain:g})"
        LOG.warning(f"warning: {least}; give it more time, voltage or range")
    LOG.info(found.sentence)
    LOG.info(_start(found, mechanism))
    return 0


def _start(found: Design, mechanism: Mechanism) -> str:
    pose = ",".join(f"{q:.6f}" for q in found.start)
    return f"start at rest at {pose} {mechanism.position_unit}"


def _head(found: Design, mechanism: Mechanism, options: argparse.Namespace) -> list[str]:
    source = f", {options.parameters or options.model}" if (options.parameters or options.model) else ""
    return [
        f"puma-sim excite --separate {','.join(found.suspects)}",
        found.sentence,
        f"plant {mechanism.name}{source}; {found.motion.seconds:g} s; seed {found.seed}",
        _start(found, mechanism),
    ]


def _write(path: str, head: list[str], time: np.ndarray, group: str, values: np.ndarray) -> None:
    names = ["time", *(f"{group}{j + 1}" for j in range(values.shape[1]))]
    with output_file(path) as file:
        for line in head:
            file.write(f"# {' '.join(line.split())}\n")
        file.write(",".join(names) + "\n")
        for t, row in zip(time.tolist(), values.tolist()):
            file.write(",".join([f"{t:.9f}", *(f"{v:.6f}" for v in row)]) + "\n")


COMMAND = Command("excite", "write voltages that tell effects apart, or show one", __doc__, add_arguments, run)
