# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Errors of an explanation in the measures that others publish, so that the two can be compared."""

from __future__ import annotations

import numpy as np

from puma_sim_core.errors import PumaSimError
from puma_sim_core.identify.data.filters import low_pass
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.recording.recording import Recording
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.windows import run_windows


def free_run(model, paths, columns) -> float:
    """Mean absolute error of the positions [rad or m] in runs from the voltage alone, from rest; mean over the logs."""
    errors = []
    for path in paths:
        log = read_log(path, columns, model.joints)
        simulator = Simulator(model)
        simulator.reset(log.position[0])
        run = simulator.run(log.time, log.voltage, enable=log.enable)
        errors.append(np.abs(run.position - log.position).mean())
    return float(np.mean(errors))


def windows(model, paths, columns, seconds, cutoff=None) -> float:
    """RMS of the positions [rad or m] in open-loop windows of so many seconds, over all rows of the logs.

    cutoff : the windows start from the motion below so many Hz, without phase; None: from the slope of the rows nearby,
    which coarse encoder steps make uncertain.
    """
    squares, rows = 0.0, 0
    for path in paths:
        log = read_log(path, columns, model.joints)
        position, velocity = (log.position, None) if cutoff is None else smoothed(log, cutoff)
        recording = Recording(time=log.time, voltage=log.voltage, position=position, velocity=velocity)
        run, errors = run_windows(Simulator(model), recording, seconds)
        if cutoff is None:
            squares += float((errors.rms**2).mean()) * (len(log) - 1)
        else:
            squares += float(((run.position - log.position)[1:] ** 2).mean()) * (len(log) - 1)
        rows += len(log) - 1
    return float(np.sqrt(squares / rows))


def smoothed(log, cutoff) -> tuple[np.ndarray, np.ndarray]:
    """Position [rad or m] and velocity (n, J) of a log below a cutoff [Hz], without phase."""
    step = float(np.median(np.diff(log.time)))
    even = log.time[0] + step * np.arange(round((log.time[-1] - log.time[0]) / step) + 1)
    values = np.column_stack([np.interp(even, log.time, column) for column in log.position.T])
    return tuple(
        np.column_stack([np.interp(log.time, even, column) for column in part.T])
        for part in low_pass(values, step, cutoff, (0, 1))
    )


def voltage_share(explanation, paths, columns, cutoff) -> float:
    """RMS of the voltage below a cutoff [Hz] that the augmented model lacks along the logs, as a share of the
    voltage's [%]: as a regression on rows that it is judged by."""
    voltage = [read_log(path, columns, explanation.model.joints) for path in paths]
    squares = [_low(log.time, log.voltage, cutoff) for log in voltage]
    drawn = explanation.drawn
    left = _low(drawn.time, drawn.augmented, cutoff)
    return float(100.0 * np.sqrt((left**2).mean() / (np.concatenate(squares) ** 2).mean()))


def _low(time, values, cutoff) -> np.ndarray:
    """Values (n, J) below a cutoff [Hz], without phase; evenly spaced but for rows between logs."""
    return low_pass(np.asarray(values, dtype=float), float(np.median(np.diff(time))), cutoff)[0]


def measured(reference, explanation, paths, columns) -> float | None:
    """Our error in the measure of a reference (its mapping), or None where it has none or the model cannot be run."""
    if reference is None or reference["computed"] is None or explanation.model is None:
        return None
    try:
        cutoff = reference["cutoff"]
        if reference["computed"] == "voltage_share":
            return voltage_share(explanation, paths, columns, cutoff)
        if reference["computed"] == "windows":
            return windows(explanation.model, paths, columns, reference["seconds"], cutoff)
        return free_run(explanation.model, paths, columns)
    except PumaSimError:
        return None
