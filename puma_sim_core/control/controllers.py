# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Controllers by their names, with the settings of ``config/controllers.yaml``.

All have one interface: ``period``, ``reset()``, ``update(t, setpoint, measurement) -> 3 volts``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from copy import deepcopy
from math import inf

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.control.computed_torque import ComputedTorque
from puma_sim_core.control.scheduled import GainSchedule, ScheduledPid
from puma_sim_core.dynamics.pid import Pid, PidGains
from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml
from puma_sim_core.plant.plant import Plant
from puma_sim_core.resources import config_path

KINDS = ("pid", "scheduled", "computed_torque")
#: "servo": thirty samples in 28 ms, no delay; "external": one each 28 ms, a sample late
GROUPS = ("servo", "external")
_PID_KEYS = ("gain", "integral_time", "derivative_time")


def load_settings(kind: str, group: str = "servo", path: str | os.PathLike | None = None) -> dict:
    """Settings of a kind of controller; path : a file of the form of config/controllers.yaml.

    Raises
    ------
    ParameterError : an unknown kind or group, a file that cannot be read or lacks it.
    """
    _check_kind(kind)
    if group not in GROUPS:
        raise ParameterError(f"group '{group}'", where="controllers", expected=" or ".join(GROUPS))
    path = config_path("controllers.yaml") if path is None else path
    found = read_yaml(path)
    for key in (group, kind):
        if not isinstance(found, Mapping) or not isinstance(found.get(key), Mapping):
            raise ParameterError(
                f"no settings {group}: {kind}:", where=str(path), expected="the form of config/controllers.yaml"
            )
        found = found[key]
    return deepcopy(dict(found))


def make_controller(
    kind: str,
    model: ArmParameters | Plant,
    settings: Mapping | None = None,
    period: float = 0.028 / 30.0,
    voltage_limit: float = 40.0,
    *,
    setpoint_period: float = 0.028,
    amplifier_gain: float = 1.0,
):
    """A controller of the three joints.

    Parameters
    ----------
    kind : "pid", "scheduled" or "computed_torque".
    model : the arm as computed torque knows it; the others need none.
    settings : as `load_settings` gives them (of the group "servo" where None).
    period : h [s], the stated rate; setpoint_period : time between setpoints [s].
    voltage_limit : at the motor [V]; amplifier_gain : motor volts per volt of the controller.

    Raises
    ------
    ParameterError : names the setting that cannot be.
    """
    _check_kind(kind)
    if not voltage_limit > 0.0 or not 0.0 < amplifier_gain < inf:
        raise ParameterError(
            f"voltage_limit {voltage_limit!r} V, amplifier_gain {amplifier_gain!r}",
            where="controller",
            expected="positive numbers",
        )
    settings = load_settings(kind) if settings is None else settings
    if not isinstance(settings, Mapping):
        raise ParameterError(f"settings {settings!r}", where=f"controller '{kind}'", expected="a mapping")
    if kind == "computed_torque":
        return ComputedTorque.from_settings(
            model, settings, period, limit=voltage_limit, setpoint_period=setpoint_period, amplifier_gain=amplifier_gain
        )
    settings = dict(settings)
    on_measurement = settings.pop("derivative_on_measurement", None)
    if not isinstance(on_measurement, bool):
        raise ParameterError(
            f"derivative_on_measurement = {on_measurement!r}", where=f"controller '{kind}'", expected="true or false"
        )
    limit = voltage_limit / amplifier_gain
    if kind == "scheduled":
        return ScheduledPid(GainSchedule.from_mapping(settings), period, limit=limit, on_measurement=on_measurement)
    return Pid(_pid_gains(settings), period, limit=limit, on_measurement=on_measurement)


def _check_kind(kind) -> None:
    if kind not in KINDS:
        raise ParameterError(f"controller '{kind}'", expected=" or ".join(KINDS))


def _pid_gains(settings) -> list[PidGains]:
    if set(settings) != set(_PID_KEYS):
        raise ParameterError(
            f"keys {', '.join(map(str, settings))}",
            where="controller 'pid'",
            expected=f"{', '.join(_PID_KEYS)}, derivative_on_measurement",
        )
    columns = [settings[name] for name in _PID_KEYS]
    if not all(isinstance(column, (list, tuple)) and len(column) == 3 for column in columns):
        raise ParameterError(
            f"gains {columns!r}", where="controller 'pid'", expected="three numbers of each, one for each joint"
        )
    return [PidGains(*values) for values in zip(*columns)]
