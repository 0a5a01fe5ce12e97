# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Run a file of voltages through the arm, and write its motion.

In:  columns time, voltage1..3 [s, V]; the voltages of a row hold until the next row.
Out: columns time, voltage1..3, position1..3, velocity1..3, current1..3 [s, V, rad, rad/s, A] at
     the same times; a row is the state at its time.

  puma-sim simulate volts.csv --out run.csv
  puma-sim simulate volts.csv --out run.csv --effect coulomb_friction:joint=2,torque=12
  puma-sim simulate log.csv --out run.csv --restart 2.0

A machine of one joint (--plant pendulum) has the columns voltage1, position1 and so on alone. Other columns of the
file are left out; --columns names those that are called otherwise, as for explain.

With --restart the file is a measured log, which has position1..3 [rad] too and may have
velocity1..3 and current1..3: its voltages go through the arm in open loop, which starts again
from the measured state every so many seconds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from puma_sim_core.cli.arguments import (
    Command,
    add_columns_argument,
    add_plant_arguments,
    column_names,
    input_files,
    joint_angles,
    joint_numbers,
    number,
    plant_of,
)
from puma_sim_core.cli.output import (
    LOG,
    Progress,
    add_force_argument,
    check_input,
    check_output,
    output_file,
    start_at_once,
)
from puma_sim_core.errors import LimitError, NonFiniteStateError, ParameterError, RecordingError

if TYPE_CHECKING:
    from puma_sim_core.plant.plant import Plant
    from puma_sim_core.recording.recording import Recording
    from puma_sim_core.simulation.conditions import Constraint, Limits
    from puma_sim_core.simulation.simulator import Simulator
    from puma_sim_core.simulation.windows import OpenLoopErrors


_START = (
    ("initial", "position", "rad"),
    ("initial_velocity", "velocity", "rad/s"),
    ("initial_current", "current", "A"),
)
#: steps between two looks at the clock and at Ctrl-C
_STEPS_AT_ONCE = {"numba": 2_000_000, "python": 20_000}
#: steps of a run: months of the compiled kernel, and far from where counts overflow
_MOST_STEPS = 1e14


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", help="CSV of voltages, or a log with --restart")
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV to write; - for standard output")
    add_force_argument(parser)
    add_columns_argument(parser)
    add_plant_arguments(parser)
    parser.add_argument("--initial", metavar="Q1,Q2,Q3", help="positions at the start [rad] (0), or 90deg")
    parser.add_argument("--initial-velocity", metavar="W1,W2,W3", help="velocities at the start [rad/s] (0)")
    parser.add_argument("--initial-current", metavar="I1,I2,I3", help="motor currents at the start [A] (0)")
    parser.add_argument(
        "--constrain",
        metavar="JOINT=HOW",
        action="append",
        default=[],
        help="joint1=hold, joint1=velocity:0.5 (or =velocity: the one it starts "
        "with), joint1=acceleration:1, joint1=free; may stand more than once",
    )
    parser.add_argument("--max-step", metavar="S", help="greatest step of integration [s] (28/30 ms; at most 8 ms)")
    parser.add_argument("--restart", metavar="S", help="FILE is a measured log; start from its state every S seconds")
    parser.add_argument(
        "--limits",
        choices=("report", "error", "off"),
        default="report",
        help="what happens where a row is outside the joint ranges of the arm",
    )
    parser.add_argument("--max-velocity", metavar="W1,W2,W3", help="also limit velocities [rad/s]")
    parser.add_argument("--max-acceleration", metavar="A1,A2,A3", help="also limit accelerations [rad/s^2]")


def run(options: argparse.Namespace) -> int:
    """Simulate, write, and sum up on standard error; raises the errors of the package."""
    begin, columns = time.perf_counter(), column_names(options.columns)
    _check_combination(options)
    check_input(options.file)
    check_output(options.out, [options.file, *input_files(options)], force=options.force)

    from puma_sim_core.jit import kernel_in_use
    from puma_sim_core.recording.recording import read_csv, write_rows
    from puma_sim_core.simulation.windows import run_windows

    plant = plant_of(options)
    interval = None if options.restart is None else number(options.restart, "--restart")
    start, limits = _start(options, plant), _limits(options, plant)
    required, optional = (("voltage",), ()) if interval is None else (("voltage", "position"), ("velocity", "current"))
    log = read_csv(options.file, required, optional, plant.joints, columns)
    _check_last_line(options.file)
    start_at_once()  # before anything of the kernel runs; most that cannot be used has ended the command by now
    simulator = _simulator(options, plant)
    if interval is None:
        simulator.reset(**start, time=log.time[0])
    span = float(log.time[-1]) - float(log.time[0])
    if not span < _MOST_STEPS * simulator.max_step:
        expected = f"times in seconds, fewer than {_MOST_STEPS:g} steps"
        raise RecordingError(f"lasts {span:.3g} s", where=options.file, expected=expected)
    with Progress() as progress:
        errors = None
        try:
            if interval is None:
                result = _run(simulator, log, limits.acceleration is not None, progress)
            else:
                result, errors = run_windows(
                    simulator,
                    log,
                    interval,
                    acceleration=limits.acceleration is not None,
                    report=lambda rows: progress("simulating", rows / len(log)),
                )
        except NonFiniteStateError as error:
            where = f"{options.file}, row {error.step + 1} ({log.time[error.step]:.9g} s)"
            expected = "voltages, parameters and a start that the arm can follow"
            raise RecordingError("the state is no longer finite", where=where, expected=expected) from None
        exceeded = limits.first_exceeded(result)
        if exceeded and options.limits == "error":
            raise LimitError(exceeded[0], expected="a run within its limits")
        with output_file(options.out) as file:
            write_rows(result, file, lambda rows: progress("writing", rows / len(result)))
    for sentence in exceeded:
        LOG.warning("warning: %s", sentence)
    for line in _summary(options, plant.position_unit, errors):
        LOG.info(line)
    LOG.info(
        f"{len(result)} row{'s' * (len(result) != 1)}, {span:.6g} s simulated by the {kernel_in_use()} "
        f"kernel; {time.perf_counter() - begin:.2f} s in all"
    )
    return 0


def _check_combination(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other; raises ParameterError."""
    if options.restart is not None:
        for name, _, _ in _START:
            if getattr(options, name) is not None:
                expected = "one of them: a log starts from its measured state"
                raise ParameterError(f"--{name.replace('_', '-')} with --restart", expected=expected)
    if options.limits == "off":
        for name in ("max_velocity", "max_acceleration"):
            if getattr(options, name) is not None:
                what = f"--{name.replace('_', '-')} with --limits off"
                raise ParameterError(what, expected="--limits report or error")


def _simulator(options: argparse.Namespace, plant: Plant) -> Simulator:
    from puma_sim_core.simulation.run_inputs import check_step
    from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

    text, option = options.max_step, "--max-step"
    step = SERVO_PERIOD if text is None else check_step(number(text, option), option)
    return Simulator(plant, constraints=_constraints(options.constrain, plant.joints), max_step=step)


def _constraints(texts: list[str], joints: int) -> list[Constraint]:
    """One constraint a joint from the texts of --constrain; raises ParameterError."""
    from puma_sim_core.simulation.conditions import CONSTRAINTS, Constraint

    found: dict[str, Constraint] = {}
    names = [f"joint{j + 1}" for j in range(joints)]
    for text in texts:
        name, _, how = text.partition("=")
        if name not in names:
            known = "joint1, joint2 or joint3" if joints == 3 else names[0]
            raise ParameterError(f"'{text}'", where="--constrain", expected=f"{known}, =, {', '.join(CONSTRAINTS)}")
        if name in found:
            raise ParameterError(f"{name} stands twice", where="--constrain", expected="each joint once")
        try:
            found[name] = Constraint.parse(how)
        except ParameterError as error:
            where = f"--constrain {text}: {error.where}" if error.where else f"--constrain {text}"
            raise ParameterError(error.what, where=where, expected=error.expected) from None
    return [found.get(name, Constraint()) for name in names]


def _start(options: argparse.Namespace, plant: Plant) -> dict[str, tuple[float, ...]]:
    """Arguments of `Simulator.reset`."""
    return {
        name: (joint_angles if name == "position" else joint_numbers)(
            text, f"--{option.replace('_', '-')}", unit.replace("rad", plant.position_unit), plant.joints
        )
        for option, name, unit in _START
        if (text := getattr(options, option)) is not None
    }


def _limits(options: argparse.Namespace, plant: Plant) -> Limits:
    from puma_sim_core.simulation.conditions import Limits

    joints, rad = plant.joints, plant.position_unit

    def greatest(name: str, unit: str) -> tuple[float, ...] | None:
        text, option = getattr(options, name), f"--{name.replace('_', '-')}"
        values = None if text is None else joint_numbers(text, option, unit, joints)
        if values is not None and min(values) < 0.0:
            raise ParameterError(f"'{text}'", where=option, expected="no number below 0")
        return values

    ranges = None if options.limits == "off" else plant.arm.joint_ranges[:joints]
    return Limits(ranges, greatest("max_velocity", f"{rad}/s"), greatest("max_acceleration", f"{rad}/s^2"), rad)


def _check_last_line(path: str) -> None:
    """Warn of a file that may have been cut off inside its last number."""
    try:
        with open(path, "rb") as file:
            file.seek(-1, 2)
            whole = file.read() in (b"\n", b"\r")
    except OSError:  # a pipe, which has been read
        return
    if not whole:
        LOG.warning("warning: %s: the last line does not end; its last number may be cut off", path)


def _run(simulator: Simulator, log: Recording, acceleration: bool, progress: Progress) -> Recording:
    """Run all rows, some at a time; the same bits as in one call."""
    import numpy as np

    from puma_sim_core.jit import kernel_in_use
    from puma_sim_core.recording.recording import Recording
    from puma_sim_core.simulation.run_inputs import step_counts

    counts = step_counts(np.diff(log.time), simulator.max_step)
    block = np.cumsum(counts) // _STEPS_AT_ONCE[kernel_in_use()]
    ends = [*(np.flatnonzero(np.diff(block)) + 1).tolist(), len(log) - 1]
    volts: Any = log.voltage
    names = ["position", "velocity", "current"] + ["acceleration"] * acceleration
    parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
    first = 0
    for last in ends:
        rows = slice(first, last + 1)
        try:
            run = simulator.run(log.time[rows], volts[rows], acceleration=acceleration)
        except NonFiniteStateError as error:
            raise NonFiniteStateError(first + error.step) from None
        for name, values in parts.items():
            # the last row of a part is the first of the next
            values.append(getattr(run, name)[: None if last == ends[-1] else -1])
        progress("simulating", (last + 1) / len(log))
        first = last
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    return Recording(time=log.time, voltage=volts, **joined)


def _summary(options: argparse.Namespace, unit: str, errors: OpenLoopErrors | None) -> Iterator[str]:
    """Lines on the open-loop errors, joint by joint."""
    if errors is None:
        return
    windows = "window" if errors.windows == 1 else "windows"
    yield f"open-loop error of {errors.windows} {windows} of {float(options.restart):g} s [{unit}]:"
    for j in range(len(errors.rms)):
        yield (f"  joint {j + 1}: rms {errors.rms[j]:.3e}, worst {errors.worst[j]:.3e} at {errors.worst_time[j]:.6g} s")


COMMAND = Command("simulate", "run a file of voltages through the arm", __doc__, add_arguments, run)
