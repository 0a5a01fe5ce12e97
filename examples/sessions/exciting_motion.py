# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A motion of all joints from which a record shows what a model lacks, and volts to make it.

Finite Fourier series about the middle of the joints' ranges: several harmonics, many reversals,
speeds up to a good part of what the motors reach. The volts are those that a model expects to
take, with a dither of some hertz that comes from no measurement: without it, feedback makes delays
and elasticity look alike.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.plant.mechanism_file import load_mechanism

#: where the motion starts, and what it keeps around [rad]
MIDDLE = (0.0, -1.2, 1.3)
#: reach to either side [rad] and greatest speed [rad/s] of the joints
_REACH, _SPEED = (1.5, 1.3, 1.5), (1.6, 0.95, 1.9)
#: frequencies of the series lie between one period of the motion and this [Hz]
_HIGHEST, _HARMONICS = 0.9, 7
#: by so much the slow one is greater than its share
_WIDE = 1.6
#: the motion fades in over this time [s]
_FADE = 1.0
#: dither: frequencies [Hz], and the amplitude of each [V]
_DITHER, _DITHER_VOLTS = (1.3, 2.1, 3.4, 5.5, 7.7), 0.35


def motion(duration: float, period: float, seed: int) -> np.ndarray:
    """Setpoints (n, 3) [rad] each `period` [s]: finite Fourier series faded in from `MIDDLE`."""
    random = np.random.default_rng(seed)
    time = np.arange(round(duration / period) + 1) * period
    orders = np.arange(1.0, max(_HIGHEST * duration, 2.0) + 1.0)
    share = np.clip(time / _FADE, 0.0, 1.0)
    fade = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    columns = []
    for middle, reach, speed in zip(MIDDLE, _REACH, _SPEED):
        # one slow and wide, the others anywhere
        chosen = np.append(
            random.choice(orders[1:], min(_HARMONICS, len(orders)) - 1, replace=False), random.choice(orders[:2])
        )
        phase = random.uniform(0.0, 2.0 * np.pi, len(chosen))
        size = random.uniform(0.5, 1.0, len(chosen)) / chosen
        size[-1] *= _WIDE
        q = fade * (np.sin(np.outer(time, 2.0 * np.pi / duration * chosen) + phase) @ size)
        q *= min(reach / np.abs(q).max(), speed / np.abs(np.gradient(q, period)).max())
        columns.append(middle + q)
    return np.stack(columns, axis=1)


def expected_volts(parameter_set: str, duration: float, period: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints (n, 3) [rad] each `period` [s], and the volts (n, 3) to hold from each on.

    The volts are those that the arm takes in the middle of the period, and the dither.

    Raises
    ------
    ParameterError : no such parameter set.
    """
    fine = motion(duration, 0.5 * period, seed)
    velocity = np.gradient(fine, 0.5 * period, axis=0)
    acceleration = np.gradient(velocity, 0.5 * period, axis=0)
    model = load_mechanism(parameters=parameter_set)
    volts = model.model_voltage(model.start, fine, velocity, acceleration)[1::2]
    time = (np.arange(len(volts)) + 0.5) * period
    phases = np.random.default_rng([seed, 1]).uniform(0.0, 2.0 * np.pi, (3, len(_DITHER)))
    for j in range(3):
        angles = 2.0 * np.pi * np.outer(time, _DITHER) + phases[j]
        volts[:, j] += _DITHER_VOLTS * np.sin(angles).sum(axis=1)
    return fine[::2][: len(volts)], volts
