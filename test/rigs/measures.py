# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Errors of an explanation in the measures that others publish, so that the two can be compared."""

from __future__ import annotations

import numpy as np

from puma_sim_core.errors import PumaSimError
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.recording.recording import Recording
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.windows import run_windows


def free_run(model, paths, columns, seconds=None) -> float:
    """Mean absolute error of the positions [rad or m] in runs from the voltage alone, from rest; mean over the logs."""
    errors = []
    for path in paths:
        log = read_log(path, columns, model.joints)
        simulator = Simulator(model)
        simulator.reset(log.position[0])
        run = simulator.run(log.time, log.voltage, enable=log.enable)
        errors.append(np.abs(run.position - log.position).mean())
    return float(np.mean(errors))


def windows(model, paths, columns, seconds) -> float:
    """RMS of the positions [rad or m] in open-loop windows of so many seconds, over all rows of the logs."""
    squares, rows = 0.0, 0
    for path in paths:
        log = read_log(path, columns, model.joints)
        recording = Recording(time=log.time, voltage=log.voltage, position=log.position)
        _, errors = run_windows(Simulator(model), recording, seconds)
        squares += float((errors.rms**2).mean()) * (len(log) - 1)
        rows += len(log) - 1
    return float(np.sqrt(squares / rows))


def voltage_share(report, paths, columns, joints) -> float:
    """RMS of the voltage that the augmented model lacks in the validation set, as a share of the voltage's RMS [%]."""
    voltage = np.concatenate([read_log(path, columns, joints).voltage for path in paths])
    left = np.array(report["errors"]["held_out"]["voltage_rms"]["augmented"], dtype=float)
    return float(100.0 * np.sqrt((left**2).mean() / (voltage**2).mean()))


def measured(reference, explanation, report, paths, columns) -> float | None:
    """Our error in the measure of a reference (its mapping), or None where it has none or the model cannot be run."""
    if reference is None or reference["computed"] is None or explanation.model is None:
        return None
    try:
        if reference["computed"] == "voltage_share":
            return voltage_share(report, paths, columns, explanation.model.joints)
        measure = {"free_run": free_run, "windows": windows}[reference["computed"]]
        return measure(explanation.model, paths, columns, reference["seconds"])
    except PumaSimError:
        return None
