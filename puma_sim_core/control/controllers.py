# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Controllers by their names, with the settings of ``config/controllers.yaml``.

All have one interface: ``period``, ``reset()``, ``update(t, setpoint, measurement) -> 3 volts``.
"""

import os
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.checks import check_choice, check_positive
from puma_sim_core.control.computed_torque import ComputedTorque, Settings
from puma_sim_core.control.scheduled import GAIN_NAMES, GainSchedule, ScheduledPid
from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml
from puma_sim_core.plant.plant import Plant
from puma_sim_core.resources import config_path
from puma_sim_core.servo.pid import Pid, PidGains

KINDS = ("pid", "scheduled", "computed_torque")
#: "servo": thirty samples in 28 ms, no delay; "external": one every 28 ms, a sample late
GROUPS = ("servo", "external")


def load_settings(kind: str, group: str = "servo", path: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """Settings of a kind of controller; path : a file of the form of config/controllers.yaml.

    Raises ParameterError: an unknown kind or group, a file that cannot be read or lacks it.
    """
    check_choice(kind, "controller", KINDS)
    check_choice(group, "group", GROUPS, "controllers")
    path = config_path("controllers.yaml") if path is None else path
    found = read_yaml(path)
    for key in (group, kind):
        if not isinstance(found, Mapping) or not isinstance(found.get(key), Mapping):
            what, expected = f"no settings {group}: {kind}:", "the form of config/controllers.yaml"
            raise ParameterError(what, where=str(path), expected=expected)
        found = found[key]
    return deepcopy(dict(found))


def make_controller(
    kind: str,
    model: ArmParameters | Plant,
    settings: Mapping[str, Any] | None = None,
    period: float = 0.028 / 30.0,
    voltage_limit: float = 40.0,
    *,
    setpoint_period: float = 0.028,
    amplifier_gain: float = 1.0,
) -> Pid | ScheduledPid | ComputedTorque:
    """A controller of the three joints.

    kind : "pid", "scheduled" or "computed_torque".
    model : the arm as computed torque knows it; the others need none.
    settings : as `load_settings` gives them (of the group "servo" where None).
    period : h [s], the stated rate; setpoint_period : time between setpoints [s].
    voltage_limit : at the motor [V]; amplifier_gain : motor volts per volt of the controller.

    Raises ParameterError: names the setting that cannot be.
    """
    check_choice(kind, "controller", KINDS)
    where = f"controller '{kind}'"
    limit = check_positive(voltage_limit, "voltage_limit", "V", where, infinite=True)
    limit /= check_positive(amplifier_gain, "amplifier_gain", "", where)
    settings = load_settings(kind) if settings is None else settings
    if not isinstance(settings, Mapping):
        raise ParameterError(f"settings {settings!r}", where=where, expected="a mapping")
    if kind == "computed_torque":
        rates = {"setpoint_period": setpoint_period, "limit": voltage_limit, "amplifier_gain": amplifier_gain}
        return ComputedTorque(model, Settings.from_mapping(settings), period, **rates)
    settings = dict(settings)
    on_measurement = settings.pop("derivative_on_measurement", None)
    if not isinstance(on_measurement, bool):
        raise ParameterError(f"derivative_on_measurement = {on_measurement!r}", where=where, expected="true or false")
    if kind == "scheduled":
        return ScheduledPid(GainSchedule.from_mapping(settings), period, limit=limit, on_measurement=on_measurement)
    if set(settings) != set(GAIN_NAMES):
        expected = f"{', '.join(GAIN_NAMES)}, derivative_on_measurement"
        raise ParameterError(f"keys {', '.join(map(str, settings))}", where=where, expected=expected)
    columns = [settings[name] for name in GAIN_NAMES]
    if not all(isinstance(column, (list, tuple)) and len(column) == 3 for column in columns):
        raise ParameterError(f"gains {columns!r}", where=where, expected="three numbers of each, one for each joint")
    return Pid([PidGains(*values) for values in zip(*columns)], period, limit=limit, on_measurement=on_measurement)
