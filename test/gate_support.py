# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Honest logs of an arm with wrong parameters and effects, for the tests of the gate.

The loop around the simulator stands here: a controller, an amplifier and an encoder of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi

import numpy as np

from puma_sim_core.control.setpoints import smooth_share
from puma_sim_core.identify.data.log import Log
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

QUANTUM = np.array([1.0e-4, 5.8e-5, 1.2e-4])
START = np.array([0.2, -0.9, 0.8])
SERVO = 0.028 / 30.0


def perturbed(seed: int, most: float = 0.08, viscous: float = 0.25) -> np.ndarray:
    """Parameters of the arm, each wrong by up to `most`, viscous friction by up to `viscous`."""
    mechanism = load_mechanism("puma560")
    rng = np.random.default_rng((seed, 1))
    share = rng.uniform(-1.0, 1.0, len(mechanism.start))
    size = [viscous if "viscous" in p.name else most for p in mechanism.free]
    return mechanism.start * (1.0 + share * size)


def waves(
    seed: int, joints=(1, 2, 3), size: float = 0.7, low: float = 0.1, high: float = 0.7
) -> Callable[[np.ndarray], np.ndarray]:
    """Setpoints (n, 3): three sines a joint, at rest in the beginning."""
    rng = np.random.default_rng((seed, 2))
    f, phase = rng.uniform(low, high, (3, 3)), rng.uniform(0.0, 2.0 * pi, (3, 3))
    part = rng.uniform(0.2, 0.5, (3, 3)) * size

    def at(time):
        out = np.zeros((len(time), 3))
        for j in range(3):
            if j + 1 in joints:
                for k in range(3):
                    turn = 2.0 * pi * f[j, k]
                    out[:, j] += part[j, k] * (np.sin(turn * time + phase[j, k]) - np.sin(phase[j, k]))
        return START + smooth_share(time / 1.5)[:, None] * out

    return at


def moves(
    seed: int, joints=(1, 2, 3), rest: float = 0.8, duration: float = 1.0, size: float = 0.7
) -> Callable[[np.ndarray], np.ndarray]:
    """Setpoints (n, 3): moves from point to point with rests between."""
    rng = np.random.default_rng((seed, 3))
    goals = rng.uniform(-size, size, (60, 3))
    for j in range(3):
        if j + 1 not in joints:
            goals[:, j] = 0.0
    goals = np.vstack([np.zeros((1, 3)), goals])

    def at(time):
        number = np.minimum((time / (rest + duration)).astype(int), 59)
        share = smooth_share((time - number * (rest + duration) - rest) / duration)[:, None]
        return START + goals[number] * (1.0 - share) + goals[number + 1] * share

    return at


def record(
    seed: int,
    setpoint,
    *,
    duration: float = 8.0,
    step: float = 0.001,
    times: np.ndarray | None = None,
    effects: Sequence = (),
    theta=None,
    terminal: Callable | None = None,
    measured: Callable | None = None,
    dither: float = 0.0,
    gain: float = 1.0,
    quantum=QUANTUM,
    noise: float = 0.05,
    name: str = "log",
) -> Log:
    """A log of the arm under a PD controller with gravity's volts from its integral.

    times : of the rows, for uneven sampling; terminal (time, volts, currents) -> volts at the
    motors; measured (time, positions) -> positions before the encoder; noise : of the volts that
    act and are not logged [V].
    """
    mechanism = load_mechanism("puma560")
    rng = np.random.default_rng((seed, 4))
    if times is None:
        times = step * np.arange(int(round(duration / step)) + 1)
    plant = mechanism.plant(perturbed(seed) if theta is None else theta, effects)
    simulator = Simulator(plant)
    goal = setpoint(times)
    simulator.reset(goal[0])
    p, d = gain * np.array([450.0, 800.0, 400.0]), gain * np.array([12.0, 25.0, 10.0])
    tones = rng.uniform(1.0, 8.0, (3, 4))
    phases = rng.uniform(0.0, 2.0 * pi, (3, 4))
    total, last, h = np.array([0.0, -3.0, -1.0]), None, step
    volts, positions = np.empty((len(times), 3)), np.empty((len(times), 3))
    for n, t in enumerate(times):
        q = np.array(simulator.state[:3])
        if measured is not None:
            q = measured(t, q)
        if np.any(quantum):
            q = np.round(q / quantum) * quantum
        if n + 1 < len(times):
            h = times[n + 1] - t
        error = goal[n] - q
        speed = np.zeros(3) if last is None else (q - last) / h
        rate = np.zeros(3) if last is None else (goal[n] - goal[n - 1]) / h
        last = q
        total = total + error * h * p * 4.0
        v = p * error + d * np.clip(rate - speed, -4.0, 4.0) + total + 15.0 * rate
        v = v + dither * np.sin(2.0 * pi * tones * t + phases).sum(axis=1)
        v = np.clip(v, -40.0, 40.0)
        volts[n], positions[n] = v, q
        acts = v if terminal is None else terminal(t, v, np.array(simulator.state[6:]))
        simulator.step(acts + noise * rng.standard_normal(3), h)
    return Log(name=name, time=times, voltage=volts, position=positions)
