# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What a run is given, checked and in the form that the kernel takes."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import BACKEND

#: RK4 is stable up to about 8.4 ms with the electrical time constant L/R of 3 ms
GREATEST_STEP = 0.008


def three(values, name: str) -> tuple[float, float, float]:
    """Three finite floats, or a ParameterError that names them."""
    try:
        result = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        result = ()
    if len(result) != 3 or not all(map(isfinite, result)):
        raise ParameterError(f"{name} = {values!r}", expected="three finite numbers")
    return result


def widened(values, name: str, joints: int) -> tuple[float, float, float]:
    """Numbers of the kernel's three joints for those of a plant's; a single one is its third.

    Raises
    ------
    ParameterError : not as many finite numbers as there are joints.
    """
    if joints == 3:
        return three(values, name)
    given = np.atleast_1d(np.asarray(values, dtype=float))
    if given.shape == (3,) and not given.any():
        given = given[:1]  # the zeros of a default
    if given.shape != (1,) or not np.isfinite(given).all():
        raise ParameterError(f"{name} = {values!r}", expected="one finite number")
    return 0.0, 0.0, float(given[0])


def check_step(step: float, where: str = "step") -> float:
    """The step [s], or a ParameterError where RK4 would not be stable."""
    if not isfinite(step) or not 0.0 < step <= GREATEST_STEP:
        raise ParameterError(
            f"{step * 1e3:.6g} ms",
            where=where,
            expected=f"more than 0 and at most {GREATEST_STEP * 1e3:g} ms: RK4 is "
            "unstable above 8.4 ms with L/R = 3 ms",
        )
    return float(step)


def step_counts(duration: np.ndarray, max_step: float) -> np.ndarray:
    """Steps of integration for each duration [s], of at most `max_step` [s].

    Rounding of the times that a duration is the difference of does not make a step more: a step
    may exceed max_step by a millionth.
    """
    return np.maximum(1, np.ceil(duration / max_step * (1.0 - 1e-6))).astype(np.int64)


def native(numbers: Sequence[float]):
    """Flat numbers as the kernel reads them fastest: an array when compiled, else a list."""
    return np.array(numbers, dtype=float) if BACKEND == "numba" else [float(n) for n in numbers]


def rows_of(values: np.ndarray):
    """An array for the compiled kernel, nested lists of floats for the interpreted one."""
    return np.ascontiguousarray(values) if BACKEND == "numba" else values.tolist()


def guarded(out, run, *arguments) -> int:
    """A run's first row of `out` that is not finite; plain Python tells some of those by an
    exception."""
    if BACKEND == "numba":
        return run(*arguments)
    out[:] = np.nan
    try:
        return run(*arguments)
    except (OverflowError, ValueError, ZeroDivisionError):
        return int(np.flatnonzero(np.isnan(out[:, 0]))[0])


def setpoint_table(setpoint, period, voltage_limit) -> np.ndarray:
    """(n, 3) setpoints [rad] as an array, or a ParameterError on what a closed loop cannot use."""
    setpoint = np.ascontiguousarray(setpoint, dtype=float)
    if setpoint.ndim != 2 or setpoint.shape[1] != 3 or not np.isfinite(setpoint).all():
        raise ParameterError(f"setpoint of shape {setpoint.shape}", expected="(n, 3), finite")
    if not len(setpoint):
        raise ParameterError("no setpoint", expected="one at least")
    if not voltage_limit > 0.0:
        raise ParameterError(f"voltage_limit {voltage_limit!r} V", expected="a positive number")
    if not (isfinite(period) and period > 0.0):
        raise ParameterError(f"period {period!r} s", expected="a positive number")
    return setpoint


def table(time, values, name: str, joints: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """(n,) times [s] and (n, 3) values as arrays, or a ParameterError on what they lack; of one
    joint, (n, 1) values go to the last column."""
    time = np.ascontiguousarray(time, dtype=float)
    values = np.ascontiguousarray(values, dtype=float)
    if time.ndim != 1 or len(time) < 1 or values.shape != (len(time), joints):
        raise ParameterError(
            f"time of shape {time.shape} and {name} of shape {values.shape}", expected=f"(n,) and (n, {joints})"
        )
    if not (np.isfinite(time).all() and np.isfinite(values).all()):
        raise ParameterError(f"time or {name} has values that are not finite", expected="finite numbers")
    if (np.diff(time) <= 0.0).any():
        raise ParameterError("times that do not increase", expected="increasing times")
    if joints < 3:
        values = np.ascontiguousarray(np.pad(values, ((0, 0), (3 - joints, 0))))
    return time, values
