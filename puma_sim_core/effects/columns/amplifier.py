# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of what the power amplifier does to the voltage: clipped, lost, shifted, late."""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects.columns.common import (
    bounded,
    candidate,
    on_joint,
    positive,
    recursion,
    stretches,
    visible,
    volt_scale,
)
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals

#: shares of the samples that lie beyond a limit, for the grids of limits
_BEYOND = (0.003, 0.008, 0.016, 0.03, 0.055, 0.09, 0.14, 0.2, 0.28, 0.38, 0.5)
#: half widths of a dead-band, in voltages of a middling friction torque
_DEAD_BANDS = np.geomspace(0.1, 2.4, 11)
#: input delays [s]
_DELAYS = (0.0005, 0.001, 0.002, 0.003, 0.0045)
#: how far the coefficient of an effect without one may come out from 1.00
_SHARP = 0.05


def _excess(values: np.ndarray, limit: float) -> np.ndarray:
    return values - np.clip(values, -limit, limit)


def _limits(values: np.ndarray) -> list[tuple[float, float]]:
    """Limits that the magnitude of `values` exceeds for a while, each with the reach of its
    neighbours: a second column moves the limit within it."""
    magnitude = np.abs(values)
    levels = np.quantile(magnitude, 1.0 - np.asarray(_BEYOND))
    # a signal that is itself clipped ends in a level that it never exceeds
    levels = np.unique(levels[levels < 0.999 * magnitude.max()])
    if levels.size == 0 or levels[-1] <= 0.0:
        return []
    edges = np.concatenate([[levels[0]], levels, [magnitude.max()]])
    return [
        (float(level), float(max(0.3 * (edges[n + 2] - edges[n]), 1e-3 * level)))
        for n, level in enumerate(levels)
        if level > 0.0
    ]


def saturation(signals: Signals, joint: int) -> list[Candidate]:
    """V - clip(V, +-Vs) with coefficient 1, and its change per volt of Vs, for a grid of Vs."""
    voltage = signals.voltage[:, joint]
    most = float(np.abs(voltage).max())
    found = []
    for limit, reach in _limits(voltage):
        excess = _excess(voltage, limit)

        def values(c, limit=limit):
            return {"voltage": positive(limit + c[1], "supply voltage", "V", most)}

        columns = on_joint(joint, excess, -np.sign(excess))
        if visible(columns):
            found.append(
                candidate(columns, [1.0, 0.0], [_SHARP, reach], values, {"voltage": limit}, VOLTAGE_COLUMN, fixed=True)
            )
    return found


def current_limit(signals: Signals, joint: int) -> list[Candidate]:
    """The part of V - ke N qd that would drive more than R imax through the winding.

    The measured motion is that of the limited current, so that the model's current never exceeds
    the limit: what does is the voltage over the resistance, delayed by the winding's L/R.
    """
    emf = signals.emf[joint]
    if emf == 0.0:  # a current-controlled amplifier: its limit is one of the command
        return []
    drop = _winding(signals, joint, signals.voltage[:, joint] - emf * signals.velocity[:, joint])
    resistance = signals.volts_per_torque[joint] * _torque_per_ampere(signals, joint)
    found = []
    for limit, reach in _limits(drop):
        excess = _excess(drop, limit)

        def values(c, limit=limit):
            return {"current": positive((limit + c[1]) / resistance, "current limit", "A")}

        columns = on_joint(joint, excess, -np.sign(excess))
        if visible(columns):
            found.append(
                candidate(
                    columns,
                    [1.0, 0.0],
                    [2.0 * _SHARP, reach],
                    values,
                    {"current": float(limit / resistance)},
                    VOLTAGE_COLUMN,
                    fixed=True,
                )
            )
    return found


def _torque_per_ampere(signals: Signals, joint: int) -> float:
    if signals.torque_per_ampere is not None:
        return float(signals.torque_per_ampere[joint])
    current, torque = signals.current[:, joint], signals.torque[:, joint]
    return float(current @ torque / max(current @ current, 1e-300))


def _winding(signals: Signals, joint: int, volts: np.ndarray) -> np.ndarray:
    """Voltage over the resistance of a winding to which `volts` is applied, from the steady
    current of the first sample on."""
    lag = float(signals.lag[joint])
    if lag <= 0.0:
        return volts
    out = np.empty_like(volts)
    kept = float(np.exp(-signals.step / lag))
    for part in stretches(signals):
        # the voltage between two samples is about the mean of both
        driving = volts[part].copy()
        driving[1:] = 0.5 * (volts[part][1:] + volts[part][:-1])
        out[part] = recursion(np.full_like(driving, kept), (1.0 - kept) * driving, float(driving[0]))
    return out


def dead_band(signals: Signals, joint: int) -> list[Candidate]:
    """clip(V, +-d) with coefficient 1, and its change per volt of d, for a grid of d."""
    voltage = signals.voltage[:, joint]
    unit, most = volt_scale(signals, joint), float(np.abs(voltage).max())
    found = []
    for width in unit * _DEAD_BANDS:
        if width > 0.5 * most:
            break

        def values(c, width=float(width)):
            return {"voltage": positive(width + c[1], "half width of the dead-band", "V", 4.0 * unit)}

        columns = on_joint(joint, np.clip(voltage, -width, width), np.sign(_excess(voltage, width)))
        if visible(columns):
            found.append(
                candidate(
                    columns,
                    [1.0, 0.0],
                    [_SHARP, 0.2 * width],
                    values,
                    {"voltage": float(width)},
                    VOLTAGE_COLUMN,
                    fixed=True,
                )
            )
    return found


def offset(signals: Signals, joint: int) -> list[Candidate]:
    """A constant; its coefficient is the offset."""
    unit = volt_scale(signals, joint)

    def values(c):
        return {"voltage": bounded(c[0], "offset", "V", 6.0 * unit)}

    return [candidate(on_joint(joint, np.ones(len(signals.time))), [0.0], [0.5 * unit], values, unit=VOLTAGE_COLUMN)]


def droop(signals: Signals, joint: int | None) -> list[Candidate]:
    """V sum |i| of all joints; the coefficient is the share lost per ampere."""
    total = np.abs(signals.current).sum(axis=1)

    def values(c):
        return {"coefficient": positive(c[0], "droop", "1/A", 0.05)}

    column = {j: signals.voltage[:, j] * total for j in range(signals.joints)}
    return [candidate([column], [0.004], [0.005], values, unit=VOLTAGE_COLUMN)]


def delay(signals: Signals, joint: int | None) -> list[Candidate]:
    """(V(t) - V(t - T)) / T on every joint for a grid of T; the coefficient is the delay.

    The exact difference holds at the frequencies where T dV/dt no longer does.
    """
    found = []
    for time in _DELAYS:
        column = {j: (signals.voltage[:, j] - _late(signals, j, time)) / time for j in range(signals.joints)}

        def values(c):
            return {"time": positive(c[0], "delay", "s", 0.03)}

        found.append(candidate([column], [time], [0.5 * time], values, {"time": time}, VOLTAGE_COLUMN))
    return found


def _late(signals: Signals, joint: int, time: float) -> np.ndarray:
    voltage = signals.voltage[:, joint]
    out = np.empty_like(voltage)
    for part in stretches(signals):
        t = signals.time[part]
        out[part] = np.interp(t - time, t, voltage[part])
    return out


_LIMITS_CURRENT = "is exceeded at one current, whatever the speed: at a fast reversal long before the greatest voltage"

SCREENINGS = {
    "voltage_saturation": Screening(
        saturation,
        look_alikes=(
            ("quadratic_friction", "nothing is missing below the supply voltage, and all of the excess above it"),
            ("supply_droop", "the limit does not give way under the currents of other joints"),
            ("current_limit", "the limit is one of the voltage, not of the current"),
            ("input_delay", "the shortfall is that of the peaks, not of fast changes"),
        ),
        excitation="Voltages that reach the supply, as in fast motion of the joint.",
        plausible=(("voltage", 1.0, 60.0),),
    ),
    "current_limit": Screening(
        current_limit,
        look_alikes=(
            ("voltage_saturation", "the limit " + _LIMITS_CURRENT),
            ("quadratic_friction", "the shortfall comes at great torque, not at great speed"),
            ("supply_droop", "the joint's own current explains it, not that of the others"),
        ),
        excitation="Fast reversals, so that back-EMF and voltage add up.",
        plausible=(("current", 0.5, 20.0),),
        fast=True,
    ),
    "voltage_dead_band": Screening(
        dead_band,
        look_alikes=(
            (
                "coulomb_friction",
                "the step follows the sign of the voltage, not of the velocity: "
                "the two differ where gravity drives the joint or brakes it",
            ),
            ("voltage_offset", "the loss changes sign with the voltage"),
            ("asymmetric_coulomb_friction", "the step has one height, by the sign of the voltage"),
        ),
        excitation="Motion that gravity helps, with small voltages of both signs.",
        plausible=(("voltage", 0.05, 1.5),),
    ),
    "voltage_offset": Screening(
        offset,
        look_alikes=(
            ("asymmetric_coulomb_friction", "the constant does not need the joint to move"),
            ("joint_spring", "the constant does not change with the position"),
            ("base_tilt", "the constant does not turn with the pose"),
            ("encoder_offset", "the constant does not follow the slope of gravity's torque"),
            ("payload", "the constant stays on its joint and is the same in all poses"),
            ("voltage_dead_band", "the constant does not change sign with the voltage"),
        ),
        excitation="Any motion; both directions and many poses tell it from gravity.",
        plausible=(("voltage", 0.02, 1.0),),
    ),
    "supply_droop": Screening(
        droop,
        look_alikes=(
            ("resistance_drift", "the loss follows the currents of all joints at once, from the beginning on"),
            ("voltage_saturation", "the loss is in proportion to the voltage, without a threshold"),
            ("quadratic_friction", "a joint loses voltage also by the currents of the others"),
            ("current_limit", "the currents of the other joints explain it too, without a threshold"),
        ),
        excitation="Joints that move alone, and then together.",
        plausible=(("coefficient", 0.001, 0.03),),
    ),
    "input_delay": Screening(
        delay,
        look_alikes=(
            (
                "sensor_lag",
                "a delay shifts all frequencies by one time and all joints alike; a "
                "lag of the sensor is the joint's own and bends with the frequency",
            ),
            ("joint_elasticity", "the shift has no resonance and is common to all joints"),
            ("voltage_saturation", "the shortfall is that of fast changes, not of the peaks"),
        ),
        excitation="A dither of 5 to 20 Hz on the voltage, best without feedback.",
        plausible=(("time", 0.0003, 0.01),),
        fast=True,
    ),
}
