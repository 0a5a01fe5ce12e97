# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Records that are hard in one way each: limits, delays, stops and gaps set by the motion, not by a size.

The effects of the other records are scaled until they have the size that is asked for. Here the parameters are drawn
from what a machine may have, relative to what the motion asks of it, and the size is what comes out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from blind import arm_parameters as arm
from blind.effects import NO_STOP

#: a limit is at least so many times what gravity asks for along the motion: the arm does not fall
_HELD = 1.1


@dataclass(frozen=True)
class Demand:
    """What a motion asks of a joint without the effect: (n,) position [rad], voltage [V], current [A], and the current
    [A] and voltage [V] that hold it against gravity."""

    position: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    holding_current: np.ndarray
    holding_voltage: np.ndarray


Draw = Callable[[np.random.Generator, int, Demand], dict]


@dataclass(frozen=True)
class Case:
    """effects : names; draw : name -> (rng, joint, demand) -> parameters, for effects that are not scaled to a size;
    motions : kinds that may be drawn, none for those of the first effect; periods : of the servo [s], none for all."""

    effects: tuple[str, ...]
    draw: Mapping[str, Draw] = field(default_factory=dict)
    motions: tuple[str, ...] = ()
    periods: tuple[float, ...] = ()


def _decades(rng, low: float, high: float) -> float:
    return float(10.0 ** rng.uniform(np.log10(low), np.log10(high)))


def _exceeded(rng, series: np.ndarray, holding: np.ndarray) -> float:
    """A limit that 2 to 50 % of the rows ask for more than."""
    limit = np.quantile(np.abs(series), 1.0 - _decades(rng, 0.02, 0.5))
    return float(f"{max(limit, _HELD * np.abs(holding).max()):.4g}")


def _current(rng, j: int, asked: Demand) -> dict:
    return {"current": _exceeded(rng, asked.current, asked.holding_current)}


def _voltage(rng, j: int, asked: Demand) -> dict:
    return {"voltage": _exceeded(rng, asked.voltage, asked.holding_voltage)}


def _stop(rng, j: int, asked: Demand) -> dict:
    """A stop that 3 to 60 % of the motion would pass, from a rubber buffer to steel."""
    beyond, upper = _decades(rng, 0.03, 0.6), rng.random() < 0.5
    place = float(f"{np.quantile(asked.position, 1.0 - beyond if upper else beyond):.6g}")
    stiffness = float(f"{_decades(rng, 20.0, 2e4):.4g}")
    return {"lower": -NO_STOP if upper else place, "upper": place if upper else NO_STOP, "stiffness": stiffness}


def _gap(low: float, high: float) -> Draw:
    def draw(rng, j: int, asked: Demand) -> dict:
        stiffness = _decades(rng, 5e4, 2e6)
        # of 1 kg.m2 on the teeth
        damping = 2.0 * _decades(rng, 0.02, 0.3) * np.sqrt(stiffness)
        values = {"gap": _decades(rng, low, high), "stiffness": stiffness, "damping": damping}
        return {name: float(f"{value:.4g}") for name, value in values.items()}

    return draw


def _payload(rng, j, asked) -> dict:
    places = {"x": rng.uniform(-0.08, 0.08), "y": rng.uniform(-0.05, 0.05), "z": rng.uniform(0.43, 0.63)}
    return {"mass": float(f"{_decades(rng, 0.7, 6.0):.4g}"), **{name: float(f"{v:.4g}") for name, v in places.items()}}


def _delay(rng, j, asked) -> dict:
    return {"time": float(f"{_decades(rng, 2e-3, 8e-3):.4g}")}


_FAST = (0.028 / 30, 1e-3)
CASES: dict[str, Case] = {
    "current_limit_in_use": Case(("current_limit",), {"current_limit": _current}, ("bang", "points", "repeat", "wide")),
    "voltage_limit_in_use": Case(("voltage_saturation",), {"voltage_saturation": _voltage}),
    "delay_oscillating": Case(("input_delay",), {"input_delay": _delay}, periods=_FAST),
    "stop_met_in_part": Case(("soft_stop",), {"soft_stop": _stop}),
    "small_gap": Case(("backlash",), {"backlash": _gap(1e-4, 5e-4)}, periods=_FAST),
    "large_gap": Case(("backlash",), {"backlash": _gap(2e-3, 1e-2)}),
    "payload_alone": Case(("payload",), {"payload": _payload}),
    "payload_and_current_limit": Case(("payload", "current_limit"), {"payload": _payload, "current_limit": _current}),
    "presliding_stiff": Case(("presliding_friction",), motions=("micro", "crawl")),
    "coulomb_creeping": Case(("coulomb_friction",), motions=("micro", "crawl")),
}


def oscillating_gain(rng: np.random.Generator, delay: float, period: float) -> tuple[int, float]:
    """(joint 0-based, gain [V/rad]) of a position controller at 0.9 to 1.5 times the gain at which the loop oscillates.

    The loop is that of a motor with its mechanical time constant tau: emf s (1 + tau s), with the delay and half a
    period of the hold. It oscillates where w (delay + period / 2) = arctan(1 / (w tau)).
    """
    p, joint = arm.nominal(), int(rng.integers(3))
    emf = p["ke"][joint] * arm.GEAR[joint]
    pose = np.array([[0.0, -np.pi / 2, np.pi / 2]])
    mass = arm.inertia(pose, p)[0, joint, joint] + p["Ia"][joint]
    tau = p["R"][joint] / (arm.GEAR[joint] * p["kt"][joint]) * mass / emf
    late, low, high = delay + 0.5 * period, 1.0, 1e4
    for _ in range(60):
        w = np.sqrt(low * high)
        low, high = (w, high) if w * late < np.arctan(1.0 / (w * tau)) else (low, w)
    return joint, float(f"{rng.uniform(0.9, 1.5) * emf * w * np.sqrt(1.0 + (w * tau) ** 2):.4g}")
