# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Find a PID controller's gains from a record of its own input and output (section 7.8).

LOG has a row for each sample of the controller, with the columns time, setpoint, position, voltage
[s, rad, rad, V], or setpoint1..3, position1..3, voltage1..3 with --joint. The positions must be
those that the controller read: --position-step rounds to an encoder's step.

  puma-sim identify-controller controller.csv
  puma-sim identify-controller samples.csv --joint 1 --position-step 1.00451e-4
  puma-sim identify-controller pose1.csv pose2.csv       are the gains the same at both poses?

Printed are Kg, Ti and Td with confidence intervals; where rounding of the voltage is the only error
in the log, with the intervals outside which they cannot be. A log that does not determine them is
refused.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from puma_sim_core.cli.arguments import Command, number
from puma_sim_core.errors import ParameterError, RecordingError

if TYPE_CHECKING:
    from puma_sim_core.tuning.controller_log import ControllerLog
    from puma_sim_core.tuning.pid_identification import GainComparison, PidEstimate
    from puma_sim_core.tuning.transfer_function import TransferFunction


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("log", metavar="LOG", help="CSV of the controller's samples")
    parser.add_argument("second", metavar="LOG2", nargs="?", help="another, taken at another pose: compare the gains")
    parser.add_argument("--joint", metavar="N", help="1, 2 or 3: which columns to take")
    parser.add_argument("--position-step", metavar="RAD", help="round the positions to this step, as the encoder did")
    parser.add_argument("--delay", metavar="N", help="samples by which the recorded voltage is late (0)")
    parser.add_argument("--limit", metavar="V", help="voltage at which the output saturates; such samples are left out")
    parser.add_argument(
        "--form",
        choices=("positional", "velocity"),
        default="positional",
        help="positional (the default): the sum includes the present error, as "
        "this program's own controllers have it; velocity: it ends one sample "
        "before, equations 7.5 to 7.7",
    )
    parser.add_argument(
        "--derivative",
        choices=("auto", "error", "measurement"),
        default="auto",
        help="what the derivative is taken of (auto: whichever fits better)",
    )
    parser.add_argument("--confidence", metavar="P", help="of the intervals (0.95)")
    parser.add_argument("--level", metavar="P", help="with LOG2: chance of a false alarm (0.01)")
    parser.add_argument("--forgetting", metavar="L", help="forgetting factor, at most 1 (1: all samples count alike)")


def run(options: argparse.Namespace) -> int:
    """Identify, compare and print; raises ParameterError and RecordingError."""
    if options.level is not None and options.second is None:
        raise ParameterError("--level with one log", expected="a second log, to compare with")
    settings: dict[str, Any] = {"form": options.form, "derivative": options.derivative}
    for name in ("confidence", "forgetting", "limit"):
        if (text := getattr(options, name)) is not None:
            settings[name] = number(text, f"--{name}")
    level = 0.01 if options.level is None else number(options.level, "--level")

    from puma_sim_core.tuning.pid_identification import compare_gains, identify_pid

    logs = [_log(path, options) for path in (options.log, options.second) if path is not None]
    found = [identify_pid(log, **settings) for log in logs]
    comparison = compare_gains(*found, level=level) if len(found) == 2 else None
    for log, estimate in zip(logs, found):
        print("\n".join(_report(estimate, _free(log, estimate, options))), end="\n\n")
    if comparison is not None:
        print("\n".join(_verdict(comparison)))
    return 0


def _log(path: str, options: argparse.Namespace) -> ControllerLog:
    from puma_sim_core.tuning.controller_log import read_controller_log

    log = read_controller_log(path, _whole(options.joint, "--joint"))
    if options.position_step is not None:
        log = log.with_counts(number(options.position_step, "--position-step"))
    delay = _whole(options.delay, "--delay")
    return log if delay is None else log.with_delay(delay)


def _whole(text: str | None, option: str) -> int | None:
    if text is None:
        return None
    value = number(text, option)
    if value != int(value):
        raise ParameterError(f"'{text}'", where=option, expected="a whole number")
    return int(value)


def _free(log: ControllerLog, estimate: PidEstimate, options: argparse.Namespace) -> TransferFunction | None:
    """The transfer function with a free denominator, where there is one from the error alone."""
    from puma_sim_core.tuning.transfer_function import METHODS, identify_transfer_function

    if estimate.derivative == "measurement" or estimate.saturated:
        return None
    try:
        return identify_transfer_function(
            log,
            method=METHODS[1],
            confidence=estimate.confidence,
            forgetting=(1.0 if options.forgetting is None else float(options.forgetting)),
        )
    except RecordingError:  # enough motion for three gains, not for five coefficients
        return None


def _report(e: PidEstimate, free: TransferFunction | None) -> Iterator[str]:
    """Lines on one record."""
    steps = "".join(
        f", {what} in steps of {value:.4g} {unit}"
        for what, value, unit in (("voltage", e.voltage_step * 1e3, "mV"), ("position", e.position_step * 1e3, "mrad"))
        if value > 0.0
    )
    left_out = f", {e.saturated} saturated ones left out" if e.saturated else ""
    yield f"{e.where}: {e.samples} samples of {e.period * 1e3:.5g} ms{left_out}{steps}"
    yield f"  {'':<10}{'value':>11}  " + (
        "certain interval" if e.rounding_only else f"{e.confidence * 100:g} % interval"
    )
    names = (("Kg, V/rad", e.gain), ("Ti, s", e.integral_time), ("Td, s", e.derivative_time))
    for name, found in names:
        yield f"  {name:<10}{found.value:>11.6g}  {found.low:.6g} to {found.high:.6g}"
    q = e.coefficients
    what = {"measurement": "less the measurement", "error": "the error", "either": "the error"}[e.derivative]
    yield (f"  from {what}: ({q[0]:.7g} {q[1]:+.7g} z^-1 {q[2]:+.7g} z^-2) / (1 - z^-1)")
    if e.derivative == "measurement":
        yield (
            f"  from the setpoint: ({q[0] - q[2]:.7g} {q[1] + 2.0 * q[2]:+.7g} z^-1) / "
            "(1 - z^-1): the derivative is of the measurement, so that there is no one "
            "transfer function from the error"
        )
    if free is not None:
        a, n = [c.value for c in free.denominator], free.coefficients
        yield (
            f"  denominator left free (instrumental variables): ({n[0]:.7g} {n[1]:+.7g} z^-1 "
            f"{n[2]:+.7g} z^-2) / (1 {a[0]:+.5f} z^-1 {a[1]:+.5f} z^-2)"
        )
    yield _derivative(e)
    yield _remainder(e)
    if e.integral_time.value == float("inf"):
        yield f"  no integral action is seen; Ti is at least {e.integral_time.low:.4g} s"


def _derivative(e: PidEstimate) -> str:
    if e.derivative == "either":
        return "  derivative of the error or of the measurement: the setpoint does not tell"
    other = {"error": "measurement", "measurement": "error"}[e.derivative]
    beside = (
        "as given"
        if e.other_residual is None
        else f"{e.residual:.3g} V rms are left; of the {other} they would be {e.other_residual:.3g} V"
    )
    return f"  derivative of the {e.derivative}: {beside}"


def _remainder(e: PidEstimate) -> str:
    if e.voltage_step == 0.0:
        return f"  {e.residual:.3g} V rms are left; the voltage has no step"
    share = e.residual / (e.voltage_step / 12.0**0.5)
    if e.rounding_only:
        return "  rounding of the voltage explains all that is left"
    if share < 1.2:
        return f"  {e.residual:.3g} V rms are left, about what rounding of the voltage leaves"
    return (
        f"  {e.residual:.3g} V rms are left, {share:.3g} times what rounding of the voltage "
        "leaves (other noise, other positions than the controller read, a delay, a limit, or "
        "gains that change)"
    )


def _verdict(c: GainComparison) -> Iterator[str]:
    """Lines on two records."""
    finding = f"the gains {'differ' if c.different else 'may be the same'}"
    chance = f"chance of such a difference with equal gains {c.p_value:.3g}"
    if c.one_controller_possible is None:
        yield f"{finding}: {chance} (level {c.level:g})"
    else:
        yield f"{finding}: {'no one' if c.different else 'one'} set of gains is within rounding of both logs ({chance})"


COMMAND = Command("identify-controller", "find a controller's PID gains from a log", __doc__, add_arguments, run)
