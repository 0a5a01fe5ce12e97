# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The library of effects, from the design notes' table: what is drawn, and how it enters.

Each effect draws its parameters with a strength of 1, which the generator then scales until the
effect has the size that the recipe asks for, within what a machine can have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from blind import arm_parameters as arm
from blind import drives
from blind.arm_mujoco import Mechanics

#: where the stop of the other side stands [rad]: out of reach
NO_STOP = 100.0
WHOLE_ARM = ("payload", "base_tilt", "supply_droop", "input_delay")
K = np.array([0.0980, 0.0568, 0.1143])  # V per N.m
#: a torque of one floor, about 60 mV, on each joint
UNIT = 0.06 / K


@dataclass
class Plant:
    """What makes a plant different from the rigid arm."""

    table: np.ndarray = field(default_factory=drives.no_effects)
    mechanics: Mechanics = field(default_factory=Mechanics)
    droop: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True)
class Effect:
    """How one effect of the table is made.

    draw : (rng, joint) -> parameters at strength 1; scaled : names that grow with the strength;
    most : joint -> greatest strength; put : (plant, joint, parameters); motions : kinds of motion
    that show it; joints : where it can be; band : of the dither that it needs, None for none;
    family : effects of one family are not paired; open_loop : whether it can be had without
    feedback; start : strength tried first; least : smallest strength; free : decades that the
    strength is drawn from, where retuning beyond all plausible parameters leaves no size to aim at.
    """

    draw: Callable
    scaled: tuple[str, ...]
    most: Callable
    put: Callable
    motions: tuple[str, ...]
    family: str
    joints: tuple[int, ...] = (0, 1, 2)
    band: tuple[float, float] | None = None
    open_loop: bool = True
    start: float = 3.0
    least: float = 0.0
    free: tuple[float, float] | None = None


def scaled(effect: Effect, parameters: dict, strength: float) -> dict:
    """Parameters at a strength, rounded so that the answers say exactly what was simulated."""
    return {
        name: float(f"{value * (strength if name in effect.scaled else 1.0):.6g}") for name, value in parameters.items()
    }


def _set(column_values):
    def put(plant, j, p):
        for column, value in column_values(p).items():
            plant.table[j, column] = value

    return put


def _torque(low, high):
    """Strength in units of about one floor; the greatest torque [N.m] by joint."""
    del low
    return lambda j: high[j] / UNIT[j]


_DRY = (27.0, 14.0, 7.5)  # N.m


def _draw_asymmetric(rng, j):
    share = rng.uniform(0.10, 0.45) * rng.choice([-1.0, 1.0])
    return {"positive": UNIT[j] * (1.0 + share), "negative": UNIT[j] * (1.0 - share)}


def _put_asymmetric(plant, j, p):
    plant.table[j, drives.COULOMB] = 0.5 * (p["positive"] + p["negative"])
    plant.table[j, drives.BIAS] = 0.5 * (p["positive"] - p["negative"])


def _draw_position(rng, j):
    return {"torque": UNIT[j], "amplitude": UNIT[j] * rng.uniform(0.35, 0.8), "angle": rng.uniform(-np.pi, np.pi)}


def _draw_stop(rng, j):
    return {
        "lower": -NO_STOP,
        "upper": NO_STOP,
        "stiffness": float(10 ** rng.uniform(2.0, 3.5)),
        "reach": 0.01,
        "side": rng.choice([-1.0, 1.0]),
    }


def _put_stop(plant, j, p):
    plant.mechanics.stop[j] = (p["lower"], p["upper"], p["stiffness"])


def _put_spring(plant, j, p):
    plant.mechanics.spring[j] = (p["stiffness"], p["angle"])


def _put_elasticity(plant, j, p):
    plant.mechanics.drive[j] = (p["stiffness"], p["damping"], 0.0)


def _put_backlash(plant, j, p):
    plant.mechanics.drive[j] = (p["stiffness"], 0.0, p["gap"])
    plant.table[j, drives.HALF_GAP] = 0.5 * p["gap"]
    plant.table[j, drives.CONTACT] = p["stiffness"]
    plant.table[j, drives.CONTACT_LOSS] = p["damping"]


def _put_payload(plant, j, p):
    plant.mechanics.payload = (p["mass"], p["x"], p["y"], p["z"])


def _put_tilt(plant, j, p):
    plant.mechanics.tilt = (p["x"], p["y"])


def _put_droop(plant, j, p):
    plant.droop = p["coefficient"]


def _put_delay(plant, j, p):
    plant.delay = p["time"]


def _draw_tilt(rng, j):
    direction = rng.uniform(-np.pi, np.pi)
    return {"x": 0.01 * np.cos(direction), "y": 0.01 * np.sin(direction)}


C = drives
EFFECTS: dict[str, Effect] = {
    "coulomb_friction": Effect(
        lambda rng, j: {"torque": UNIT[j]},
        ("torque",),
        _torque(0, _DRY),
        _set(lambda p: {C.COULOMB: p["torque"]}),
        ("fourier", "points", "triangles", "bang"),
        "friction",
    ),
    "asymmetric_coulomb_friction": Effect(
        _draw_asymmetric,
        ("positive", "negative"),
        _torque(0, _DRY),
        _put_asymmetric,
        ("fourier", "points", "triangles"),
        "friction",
    ),
    "stribeck_friction": Effect(
        lambda rng, j: {
            "torque": UNIT[j] * rng.uniform(0.3, 1.0),
            "sliding": UNIT[j],
            "velocity": rng.uniform(0.02, 0.1),
        },
        ("torque", "sliding"),
        _torque(0, _DRY),
        _set(lambda p: {C.COULOMB: p["sliding"], C.STRIBECK: p["torque"], C.STRIBECK_SPEED: p["velocity"]}),
        ("crawl", "triangles", "crawl"),
        "friction",
        open_loop=False,
    ),
    "presliding_friction": Effect(
        lambda rng, j: {"stiffness": float(10 ** rng.uniform(3.3, 4.5)), "torque": UNIT[j]},
        ("torque",),
        _torque(0, _DRY),
        _set(lambda p: {C.BRISTLE: p["stiffness"], C.BRISTLE_LEVEL: p["torque"]}),
        ("micro", "crawl", "micro"),
        "friction",
        open_loop=False,
    ),
    "quadratic_friction": Effect(
        lambda rng, j: {"coefficient": UNIT[j]},
        ("coefficient",),
        lambda j: 12.0 / UNIT[j],
        _set(lambda p: {C.QUADRATIC: p["coefficient"]}),
        ("wide", "bang", "points"),
        "speed",
    ),
    "load_dependent_friction": Effect(
        lambda rng, j: {"coefficient": 0.05},
        ("coefficient",),
        lambda j: 5.0,
        _set(lambda p: {C.LOAD: p["coefficient"]}),
        ("fourier", "wide", "points"),
        "friction",
        joints=(1, 2),
    ),
    "position_dependent_friction": Effect(
        _draw_position,
        ("torque", "amplitude"),
        _torque(0, _DRY),
        _set(lambda p: {C.COULOMB: p["torque"], C.POSITION: p["amplitude"], C.POSITION_ANGLE: p["angle"]}),
        ("wide", "fourier"),
        "friction",
    ),
    "torque_ripple": Effect(
        lambda rng, j: {
            "amplitude": UNIT[j],
            "order": float(rng.choice([1, 1, 2, 2, 3, 4])),
            "phase": rng.uniform(-np.pi, np.pi),
        },
        ("amplitude",),
        lambda j: 8.0 / UNIT[j],
        lambda plant, j, p: _set(
            lambda p: {C.RIPPLE: p["amplitude"], C.RIPPLE_ORDER: p["order"] * arm.GEAR[j], C.RIPPLE_PHASE: p["phase"]}
        )(plant, j, p),
        ("constant", "crawl", "triangles"),
        "ripple",
        open_loop=False,
    ),
    "transmission_error": Effect(
        lambda rng, j: {"amplitude": 1e-4, "order": float(rng.integers(8, 41)), "phase": rng.uniform(-np.pi, np.pi)},
        ("amplitude",),
        lambda j: 15.0,
        _set(lambda p: {C.ECCENTRIC: p["amplitude"], C.ECCENTRIC_ORDER: p["order"], C.ECCENTRIC_PHASE: p["phase"]}),
        ("wide", "fourier", "points"),
        "transmission",
    ),
    "backlash": Effect(
        lambda rng, j: {
            "gap": 3e-4,
            "stiffness": float(rng.choice([5e5, 1e6])),
            "damping": float(rng.choice([100.0, 200.0])),
        },
        ("gap",),
        lambda j: 10.0,
        _put_backlash,
        ("bang", "vertical"),
        "transmission",
        band=(2.0, 8.0),
        start=4.0,
        least=0.4,
    ),
    "joint_elasticity": Effect(
        # strength is a compliance: 1 is 5e4 N.m/rad
        lambda rng, j: {"compliance": 2e-5, "damping": float(rng.choice([0.5, 1.0, 3.0]))},
        ("compliance",),
        lambda j: 16.0,
        _put_elasticity,
        ("bang", "fourier", "points"),
        "transmission",
        band=(2.0, 14.0),
    ),
    "payload": Effect(
        lambda rng, j: {"mass": 0.5, "x": rng.uniform(-0.03, 0.03), "y": 0.0, "z": 0.4331 + rng.uniform(0.0, 0.15)},
        ("mass",),
        lambda j: 10.0,
        _put_payload,
        ("fourier", "points", "wide"),
        "load",
        free=(0.0, 1.0),
    ),
    "joint_spring": Effect(
        lambda rng, j: {"stiffness": 2.0, "angle": rng.uniform(-0.8, 0.8) + (0.0, -1.2, 1.2)[j]},
        ("stiffness",),
        lambda j: 15.0,
        _put_spring,
        ("wide", "triangles", "fourier"),
        "spring",
    ),
    "soft_stop": Effect(_draw_stop, ("reach",), lambda j: 15.0, _put_stop, ("fourier", "wide", "points"), "stop"),
    "base_tilt": Effect(_draw_tilt, ("x", "y"), lambda j: 10.0, _put_tilt, ("wide",), "gravity"),
    "resistance_drift": Effect(
        lambda rng, j: {"share": 0.12, "time_constant": rng.uniform(2.0, 15.0)},
        ("share",),
        lambda j: 5.0,
        _set(lambda p: {C.HOT: p["share"], C.HOT_TIME: p["time_constant"]}),
        ("repeat", "points"),
        "drift",
        joints=(1, 2),
    ),
    "friction_warm_up": Effect(
        lambda rng, j: {"share": 0.1, "time_constant": rng.uniform(2.0, 10.0)},
        ("share",),
        lambda j: 8.5,
        _set(lambda p: {C.WARM: p["share"], C.WARM_TIME: p["time_constant"]}),
        ("repeat", "wide", "bang"),
        "drift",
    ),
    "voltage_saturation": Effect(
        # strength shrinks the limit, from the greatest voltage of the run downwards
        lambda rng, j: {"voltage": 30.0, "share": 0.01},
        ("share",),
        lambda j: 30.0,
        _set(lambda p: {C.SATURATION: p["voltage"]}),
        ("bang", "points", "wide"),
        "amplifier",
        open_loop=False,
    ),
    "current_limit": Effect(
        lambda rng, j: {"current": 15.0, "share": 0.01},
        ("share",),
        lambda j: 30.0,
        _set(lambda p: {C.LIMIT: p["current"]}),
        ("bang", "points"),
        "amplifier",
        open_loop=False,
    ),
    "voltage_dead_band": Effect(
        lambda rng, j: {"voltage": 0.06},
        ("voltage",),
        lambda j: 1.2 / 0.06,
        _set(lambda p: {C.DEAD_BAND: p["voltage"]}),
        ("fourier", "points", "triangles"),
        "amplifier",
    ),
    "voltage_offset": Effect(
        lambda rng, j: {"voltage": 0.06 * rng.choice([-1.0, 1.0])},
        ("voltage",),
        lambda j: 0.6 / 0.06,
        _set(lambda p: {C.OFFSET: p["voltage"]}),
        ("fourier", "wide", "points"),
        "offset",
    ),
    "input_delay": Effect(
        lambda rng, j: {"time": 1e-3},
        ("time",),
        lambda j: 8.0,
        _put_delay,
        ("fourier", "bang", "points"),
        "delay",
        band=(4.0, 15.0),
    ),
    "sensor_lag": Effect(
        lambda rng, j: {"time_constant": 1e-3},
        ("time_constant",),
        lambda j: 32.0,
        _set(lambda p: {C.SENSOR_LAG: p["time_constant"]}),
        ("fourier", "bang", "points"),
        "delay",
        band=(3.0, 14.0),
    ),
    "encoder_offset": Effect(
        lambda rng, j: {"angle": 2e-3 * rng.choice([-1.0, 1.0])},
        ("angle",),
        lambda j: 30.0,
        _set(lambda p: {C.ENCODER: p["angle"]}),
        ("wide", "fourier"),
        "sensor",
        joints=(1, 2),
    ),
    "sensor_nonlinearity": Effect(
        lambda rng, j: {"amplitude": 1e-3, "period": rng.uniform(0.25, 1.6), "phase": rng.uniform(-np.pi, np.pi)},
        ("amplitude",),
        lambda j: 12.0,
        _set(lambda p: {C.NONLINEAR: p["amplitude"], C.NONLINEAR_PERIOD: p["period"], C.NONLINEAR_PHASE: p["phase"]}),
        ("wide", "fourier", "points"),
        "sensor",
    ),
    "supply_droop": Effect(
        lambda rng, j: {"coefficient": 2e-3},
        ("coefficient",),
        lambda j: 7.0,
        _put_droop,
        ("bang", "points", "fourier"),
        "amplifier",
    ),
    "impulse": Effect(
        lambda rng, j: {
            "torque": 30.0 * rng.choice([-1.0, 1.0]) / 5.0,
            "time": rng.uniform(0.2, 0.8),
            "width": rng.uniform(0.03, 0.10),
        },
        ("torque",),
        lambda j: 25.0,
        _set(lambda p: {C.PUSH: p["torque"], C.PUSH_TIME: p["time"], C.PUSH_WIDTH: p["width"]}),
        ("fourier", "points", "triangles"),
        "impulse",
    ),
}

#: the most common ones, for a first look
COMMON = (
    "coulomb_friction",
    "asymmetric_coulomb_friction",
    "stribeck_friction",
    "quadratic_friction",
    "torque_ripple",
    "joint_elasticity",
    "joint_spring",
    "payload",
    "voltage_dead_band",
    "voltage_offset",
)


def derived(name: str, parameters: dict, peak: dict, seconds: float) -> dict:
    """Parameters as the answers name them, from those drawn and from the run without the effect.

    peak : "low", "high" [rad], "voltage" [V], "current" [A] that the joint reached in it.
    """
    p = dict(parameters)
    if name == "soft_stop":
        side, reach = p.pop("side"), p.pop("reach")
        if side > 0.0:
            p["upper"] = float(f"{peak['high'] - reach:.6g}")
        else:
            p["lower"] = float(f"{peak['low'] + reach:.6g}")
    elif name in ("voltage_saturation", "current_limit"):
        what = "voltage" if name == "voltage_saturation" else "current"
        p[what] = float(f"{peak[what] * (1.0 - min(p.pop('share'), 0.7)):.5g}")
    elif name == "joint_elasticity":
        p["stiffness"] = float(f"{1.0 / p.pop('compliance'):.5g}")
    elif name == "impulse":
        p["time"] = float(f"{p['time'] * seconds:.5g}")
    return p
