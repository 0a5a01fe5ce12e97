# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a run is given, checked and in the form that the kernel takes."""

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.checks import check_numbers, check_positive, check_shapes
from puma_sim_core.dynamics.laws import TWO_MASS
from puma_sim_core.dynamics.types import Rows
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import BACKEND, is_compiled

#: RK4 is stable up to about 8.4 ms with the electrical time constant L/R of 3 ms
GREATEST_STEP = 0.008


def widened(values: Any, name: str, axes: Sequence[int], rest: Sequence[float] = (0.0, 0.0, 0.0)) -> tuple[float, ...]:
    """Numbers of the kernel's three joints for those of a plant's `axes`; the others have those of `rest`.

    Raises ParameterError: not as many finite numbers as there are joints.
    """
    if len(axes) == 3:
        return check_numbers(values, name)
    given = np.atleast_1d(np.asarray(values, dtype=float))
    if given.shape == (3,) and not given.any():
        given = given[: len(axes)]  # the zeros of a default
    out = list(rest)
    for axis, value in zip(axes, check_numbers(given, name, len(axes)), strict=True):
        out[axis] = value
    return tuple(out)


def check_step(step: float, where: str = "step") -> float:
    """The step [s], or a ParameterError where RK4 would not be stable."""
    if not isfinite(step) or not 0.0 < step <= GREATEST_STEP:
        bounds = f"more than 0 and at most {GREATEST_STEP * 1e3:g} ms"
        what, reason = f"{step * 1e3:.6g} ms", "RK4 is unstable above 8.4 ms with L/R = 3 ms"
        raise ParameterError(what, where=where, expected=f"{bounds}: {reason}")
    return float(step)


def step_counts(duration: np.ndarray, max_step: float) -> np.ndarray:
    """Steps of integration for each duration [s], of at most `max_step` [s].

    Rounding of the times that a duration is the difference of does not make a step more: a step
    may exceed max_step by a millionth.
    """
    return np.maximum(1, np.ceil(duration / max_step * (1.0 - 1e-6))).astype(np.int64)


def runs_compiled(active: int) -> bool:
    """Whether runs of a plant with these stages that begin now are compiled."""
    return is_compiled("trains" if active & TWO_MASS else "arm")


def native(numbers: Sequence[float], compiled: bool = BACKEND == "numba") -> Any:
    """Flat numbers as the kernel reads them fastest: an array when compiled, else a list."""
    return np.array(numbers, dtype=float) if compiled else [float(n) for n in numbers]


def rows_of(values: np.ndarray, compiled: bool = BACKEND == "numba") -> Any:
    """An array for the compiled kernel, nested lists of floats for the interpreted one."""
    return np.ascontiguousarray(values) if compiled else values.tolist()


def kernel_rows(
    voltage: np.ndarray, edges: np.ndarray, duration: np.ndarray, max_step: float, compiled: bool = BACKEND == "numba"
) -> Rows:
    """Rows of voltages (n, 3) [V] between edges (n + 1,) [s], which are `duration` (n,) [s] apart, in steps of at most
    max_step [s]."""
    counts = step_counts(duration, max_step)
    return Rows(*(rows_of(values, compiled) for values in (voltage, edges[:-1], counts, duration / counts)))


def guarded(out: np.ndarray, compiled: bool, run: Callable[..., int], *arguments: Any) -> int:
    """A run's first row of `out` that is not finite; plain Python tells some of those by an exception."""
    if compiled:
        return run(*arguments)
    out[:] = np.nan
    try:
        return run(*arguments)
    except (OverflowError, ValueError, ZeroDivisionError):
        return int(np.flatnonzero(np.isnan(out[:, 0]))[0])


def setpoint_table(setpoint: ArrayLike, period: float, voltage_limit: float) -> np.ndarray:
    """(n, 3) setpoints [rad] as an array, or a ParameterError on what a closed loop cannot use."""
    (table,) = check_shapes("(n, 3)", setpoint=setpoint)
    if not len(table):
        raise ParameterError("no setpoint", expected="one at least")
    check_positive(voltage_limit, "voltage_limit", "V", infinite=True)
    check_positive(period, "period", "s")
    return np.ascontiguousarray(table)


def table(time: ArrayLike, values: ArrayLike, name: str, joints: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """(n,) times [s] and (n, J) values as arrays, or a ParameterError on what they lack."""
    time, values = np.ascontiguousarray(time, dtype=float), np.ascontiguousarray(values, dtype=float)
    if time.ndim != 1 or len(time) < 1 or values.shape != (len(time), joints):
        what = f"time of shape {time.shape} and {name} of shape {values.shape}"
        raise ParameterError(what, expected=f"(n,) and (n, {joints})")
    if not (np.isfinite(time).all() and np.isfinite(values).all()):
        raise ParameterError(f"time or {name} has values that are not finite", expected="finite numbers")
    if (np.diff(time) <= 0.0).any():
        raise ParameterError("times that do not increase", expected="increasing times")
    return time, values
