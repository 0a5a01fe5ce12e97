# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs of a mechanism: read by the channels of its inputs, with the volts of servos inside its drives."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace

from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.identify.data.log import Log
from puma_sim_core.plant.mechanism import Mechanism


def read_for(mechanism: Mechanism, path: str | os.PathLike[str], columns: Mapping[str, str] | None = None) -> Log:
    """Read a file by the joints and inputs of a mechanism; see `read_log`."""
    # where nothing but the link's side is compared, it must be there
    needed = () if mechanism.links_known else [sensor is not None for sensor in mechanism.link_sensors]
    return read_log(path, columns, mechanism.joints, inputs=mechanism.inputs, link_sensors=needed)


def with_volts(log: Log, mechanism: Mechanism) -> Log:
    """The log with the volts that servos inside the drives make of its goals and positions; others as they are.

    A row's volts are the mean to the next row (`PositionServo.voltage`). Between rows the position counts as moving
    evenly, which is wrong where a row lasts longer than the servo's loop takes to settle.

    Raises RecordingError: a log without goals.
    """
    servos = mechanism.servos
    if not any(servos):
        return log
    if log.setpoint is None:
        expected = f"setpoint1..{log.joints}: '{mechanism.name}' has a servo in its drive"
        raise RecordingError("no goal positions", where=log.name, expected=expected)
    volts = log.voltage.copy()
    for j, servo in enumerate(servos):
        if servo is not None:
            volts[:, j] = servo.voltage(log.time, log.setpoint[:, j], log.position[:, j])
    note = "Voltages are those that the servo in the drive makes of goals and positions."
    return replace(log, voltage=volts, notes=(*log.notes, note))
