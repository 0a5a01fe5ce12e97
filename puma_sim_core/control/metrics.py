# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How good a control was: overshoot, rise and settling of a step, errors, volts, saturation."""

from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.checks import check_numbers, check_positive, check_shapes
from puma_sim_core.control.curve import Curve
from puma_sim_core.errors import ParameterError
from puma_sim_core.recording.recording import Recording

#: share of a step's record, at its end, over which the steady error is averaged
STEADY_SHARE = 0.1


class StepQuality(NamedTuple):
    """What a step response tells.

    overshoot : greatest excess over the end, as a share of the step; 0.0 without one.
    rise_time : from 10 to 90 % of the step [s]; inf where 90 % are not reached.
    settling_time : from the step to where the response stays within the band [s]; inf where it is
        not within at the end of the record.
    undershoot : greatest excursion to the other side of the start, as a share of the step; 0.0 without one.
    steady_error : distance from the end of the mean over the last tenth of the record, as a share of the step.
    """

    overshoot: float
    rise_time: float
    settling_time: float
    undershoot: float
    steady_error: float


def step_quality(
    time: ArrayLike,
    response: ArrayLike,
    start: float,
    end: float,
    *,
    at: float | None = None,
    band: float = 0.02,
    velocity: ArrayLike | None = None,
) -> StepQuality:
    """Quality of a response to a step from `start` to `end`.

    time (n,) [s], increasing; response (n,), of the unit of start and end; at : when the step is
    [s], by default at time[0]; band : half-width of the settled band as a share of the step; velocity : (n,), the
    derivative of the response. Between samples the response is what `curve` says of values and velocities.

    Raises ParameterError: no step, no samples behind it, or values that are not finite.
    """
    where = "step response"
    given: dict[str, Any] = {} if velocity is None else {"velocity": velocity}
    times, values, *slopes = check_shapes("(n,)", where, time=time, response=response, **given)
    if len(times) < 2 or not (np.diff(times) > 0.0).all():
        raise ParameterError(f"{len(times)} times", where=where, expected="two at least, increasing")
    check_numbers((start, end), "start and end", 2, where)
    # a step of rounding is none
    if abs(end - start) <= 1e-12 * max(abs(start), abs(end), 1e-300):
        what = f"from {start:.6g} to {end:.6g}: there is no step"
        raise ParameterError(what, where=where, expected="a start and an end that differ")
    if not 0.0 < band < 1.0:
        raise ParameterError(f"band {band!r}", where=where, expected="between 0 and 1")
    at = float(times[0]) if at is None else at
    after = times >= at - 1e-9
    if after.sum() < 2:
        raise ParameterError(f"no samples after {at:.6g} s", where=where, expected="a step within the record")
    t = times[after]
    # the distance still to go, as a share of the step
    rest = (values[after] - end) / (end - start)
    curve = Curve(t, rest, slopes[0][after] / (end - start) if slopes else None)
    low, high, settled = curve.first_above(-0.9), curve.first_above(-0.1), curve.last_beyond(band)
    lowest, highest = curve.extremes()
    return StepQuality(
        overshoot=max(highest, 0.0),
        rise_time=high - low if high < inf else inf,
        settling_time=max(settled - at, 0.0),
        undershoot=max(-1.0 - lowest, 0.0),
        steady_error=abs(curve.mean(float(t[-1] - STEADY_SHARE * (t[-1] - t[0])))),
    )


class TrackingError(NamedTuple):
    """rms and worst (greatest magnitude) of position less path, (3,) [rad]."""

    rms: np.ndarray
    worst: np.ndarray


def tracking_error(recording: Recording, path: ArrayLike | None = None) -> TrackingError:
    """Errors over a recording; path : (n, 3) [rad] at its times, by default the held setpoints.

    Samples must be evenly spaced for the rms to be one over time.

    Raises ParameterError: no positions, nothing to compare with, or another shape.
    """
    path = recording.setpoint if path is None else np.asarray(path, dtype=float)
    if path is None or recording.position is None or path.shape != recording.position.shape:
        expected = "positions and a path, both (n, 3)"
        raise ParameterError("no path beside the positions", where="tracking error", expected=expected)
    error = recording.position - path
    return TrackingError(np.sqrt((error**2).mean(axis=0)), np.abs(error).max(axis=0))


class Effort(NamedTuple):
    """rms : of the voltage (3,) [V]; saturated : share of the time at the limit (3,)."""

    rms: np.ndarray
    saturated: np.ndarray


def effort(recording: Recording, voltage_limit: float, within: float = 1e-6) -> Effort:
    """Volts of a recording, weighted by how long each row is held; the last row is held by nobody.

    voltage_limit [V], inf for none; within : distance from it that counts as at it, as a share of
    it (a converter of n bits ends 2^(1-n) of it below its limit).

    Raises ParameterError: no voltages, a single row, or a limit that is not positive.
    """
    if recording.voltage is None or len(recording) < 2:
        raise ParameterError("no voltages", where="effort", expected="two rows at least")
    check_positive(voltage_limit, "voltage_limit", "V", "effort", infinite=True)
    held = np.diff(recording.time)
    volts = recording.voltage[:-1]
    share = (held / held.sum())[:, None]
    # sums, not matrix products: the last bit of those depends on where the arrays lie in memory
    saturated = np.abs(volts) >= (1.0 - within) * voltage_limit
    return Effort(np.sqrt((share * volts**2).sum(axis=0)), (share * saturated).sum(axis=0))
