# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A bag of `sim_node` as a log: what was commanded and what was measured.

Of the model and the session that a bag also holds, only the rules that turn commands into volts are read: the voltage
limit, the watchdog, the period.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from puma_sim_core.errors import BagError, RecordingError
from puma_sim_core.files import parse_yaml
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.data.log import Log
from puma_sim_core.recording.bag import BagContents, RecordedBrakes, RecordedEffects, RecordedPlacement, read_bag


def read_bag_log(path: str | Path, joints: int) -> Log:
    """Read a bag: a row a state; the voltage of row k is the command that holds until row k + 1.

    The states' own voltages are those at the motors, behind the amplifier; commands in volts are given instead, as the
    session took them: clipped to its limit, zero when the watchdog acts. Under the position servo there are no such
    commands; the motors' voltages serve where each period has one sample of the servo. Rows in which the brakes hold
    are left out.

    Raises
    ------
    BagError : no whole bag of the simulator, or another number of joints.
    RecordingError : a position session with several servo samples in a period; one in which joints were put somewhere
        or effects changed; no row without brakes.
    """
    bag = read_bag(path)
    if len(bag.joint_names) != joints:
        raise BagError(f"{len(bag.joint_names)} joints", where=path, expected=f"{joints}, as the plant has")
    rules = parse_yaml(bag.config_text, f"{path}: topic sim_node/model", BagError)
    if not isinstance(rules, Mapping):
        raise BagError("no session", where=f"{path}: topic sim_node/model", expected="a mapping")
    changed = next((step for step, each in bag.inputs if isinstance(each, RecordedPlacement | RecordedEffects)), None)
    if changed is not None:
        what, expected = f"joints were put elsewhere, or effects changed, at step {changed}", "one machine all along"
        raise RecordingError(what, where=str(path), expected=expected)
    notes: tuple[str, ...] = ()
    if bag.command_interface == "voltage":
        voltage = _commanded(bag, rules)
    else:
        samples = int(rules.get("substeps", 1))
        if samples > 1:
            raise RecordingError(
                f"the servo took {samples} samples in each period, and the bag has the voltage of the last alone",
                where=str(path),
                expected="a session with command_interface voltage, or with substeps 1 (and a period such as 0.001)",
            )
        voltage = np.concatenate([bag.voltage[1:], bag.voltage[-1:]])
        notes = ("Voltages are those at the motors: the session commanded positions.",)
    rows = _unbraked(bag)
    if not rows.any():
        raise RecordingError("the brakes hold in all rows", where=str(path), expected="an arm that moves")
    if not rows.all():
        notes += (f"{np.count_nonzero(~rows)} rows in which the brakes hold are left out.",)
    return Log(
        name=str(path),
        time=bag.time_ns[rows] * 1e-9,
        voltage=voltage[rows],
        position=bag.position[rows],
        velocity=bag.velocity[rows],
        current=bag.current[rows],
        notes=notes,
    )


def _unbraked(bag: BagContents) -> np.ndarray:
    """(n,) whether the arm is free from a row on, or was until it."""
    moments = [(step, each.engaged) for step, each in bag.inputs if isinstance(each, RecordedBrakes)]
    held = np.zeros(len(bag.steps), dtype=bool)
    for step, engaged in moments:
        held[bag.steps >= step] = engaged
    return ~(held & np.append(held[:1], held[:-1]))


def _commanded(bag: BagContents, rules: Mapping[str, Any]) -> Floats:
    """(n, J) commanded volts that act from each state on."""
    limit = float(rules.get("voltage_limit", np.inf))
    timeout, period = float(rules.get("command_timeout", 0.0)), float(rules.get("period", 0.0))
    patience = max(1, round(timeout / period)) if timeout > 0.0 and period > 0.0 else 0
    volts = np.zeros((len(bag.steps), len(bag.joint_names)))
    now, age, commands, before = np.zeros(volts.shape[1]), 0, iter(bag.commands), -1
    pending = next(commands, None)
    for row, step in enumerate(bag.steps.tolist()):
        age, before = age + step - before, step
        while pending is not None and pending[0] <= step:
            now, age = np.clip(np.array(pending[1].values), -limit, limit), 0
            pending = next(commands, None)
        if patience and age >= patience:
            now = np.zeros(volts.shape[1])
        volts[row] = now
    return volts
