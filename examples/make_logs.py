# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Make the sample logs of this folder: ``python examples/make_logs.py [FOLDER]``.

Each log comes from a simulated machine whose parameters differ from the published ones, as those of
a real machine do. The machine follows a random motion under a proportional controller, with a
dither on the voltage. The controller's own voltage is logged, and the position of the encoder. The
same program gives the same bytes each time.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import puma_sim_core as ps

PERIOD, SECONDS = 0.005, 10.0
#: largest relative errors of the machine's parameters: viscous friction, and all others
OFF_VISCOUS, OFF = 0.20, 0.05
#: frequencies of the dither [Hz]
DITHER = (1.3, 2.1, 3.4, 5.5, 7.7)


def different_machine(mechanism: ps.Mechanism, effects, seed: int) -> ps.Plant:
    """A plant whose parameters are off by some per cent, with effects."""
    random = np.random.default_rng(seed)
    share = np.array([OFF_VISCOUS if "viscous" in p.name else OFF for p in mechanism.free])
    theta = mechanism.start * (1.0 + share * random.uniform(-1.0, 1.0, share.size))
    return mechanism.plant(theta, [ps.parse_effect(text) for text in effects])


def reference(time, middle, reach, speed, seed: int) -> np.ndarray:
    """Setpoints (n, J): sums of harmonics that fade in from rest, within a reach and a speed."""
    random = np.random.default_rng(seed)
    fade = np.clip(time, 0.0, 1.0)
    fade = fade**3 * (10.0 - 15.0 * fade + 6.0 * fade**2)
    columns = []
    for centre, widest, fastest in zip(middle, reach, speed, strict=False):
        orders = np.append(random.choice(np.arange(2, 10), 6, replace=False), 1)
        phase = random.uniform(0.0, 2.0 * np.pi, orders.size)
        size = random.uniform(0.5, 1.0, orders.size) / orders
        wave = fade * (np.sin(np.outer(time, 2.0 * np.pi / SECONDS * orders) + phase) @ size)
        wave *= min(widest / np.abs(wave).max(), fastest / np.abs(np.gradient(wave, time)).max())
        columns.append(centre + wave)
    return np.stack(columns, axis=1)


def record(plant_name, effects, seed, *, middle, reach, speed, gain, dither, encoder_step):
    """(log, voltage of the motion by the nominal model) of one machine."""
    mechanism = ps.load_mechanism(plant_name)
    simulator = ps.Simulator(different_machine(mechanism, effects, seed))
    simulator.reset(position=middle)
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    setpoint = reference(time, middle, reach, speed, seed)
    velocity = np.gradient(setpoint, PERIOD, axis=0)
    feedforward = mechanism.model_voltage(mechanism.start, setpoint, velocity, np.gradient(velocity, PERIOD, axis=0))
    random = np.random.default_rng([seed, 1])
    phases = random.uniform(0.0, 2.0 * np.pi, (len(middle), len(DITHER)))
    shake = np.stack([np.sin(2.0 * np.pi * np.outer(time, DITHER) + phase).sum(axis=1) for phase in phases], axis=1)
    feedforward += np.asarray(dither) * shake
    noise = np.asarray(dither) * 0.1 * random.standard_normal(feedforward.shape)
    voltage, position = np.empty_like(setpoint), np.empty_like(setpoint)
    joints = slice(3 - mechanism.joints, 3)  # a single joint is the third one of the state
    for k in range(len(time)):
        measured = np.round(np.asarray(simulator.state[joints]) / encoder_step) * encoder_step
        position[k] = measured
        voltage[k] = np.round(feedforward[k] + np.asarray(gain) * (setpoint[k] - measured), 4)
        simulator.step(voltage[k] + noise[k], PERIOD)
    return time, voltage, position


def write(path: Path, time, voltage, position=None) -> None:
    """A log as CSV: time to 0.1 ms, voltages to 0.1 mV, positions to 1 microradian."""
    joints = voltage.shape[1]
    groups = [("voltage", voltage, "%.4f")] + ([] if position is None else [("position", position, "%.6f")])
    names = ["time", *(f"{name}{j + 1}" for name, _, _ in groups for j in range(joints))]
    table = np.hstack([time[:, None], *(values for _, values, _ in groups)])
    formats = ["%.4f", *(form for _, _, form in groups for _ in range(joints))]
    # adding zero makes a negative zero positive
    np.savetxt(path, table + 0.0, fmt=formats, delimiter=",", header=",".join(names), comments="")


ARM = {
    "middle": (0.0, -1.2, 1.3),
    "reach": (1.5, 1.3, 1.5),
    "speed": (1.6, 0.95, 1.9),
    "gain": (60.0, 90.0, 50.0),
    "dither": (0.35, 0.35, 0.35),
    "encoder_step": np.array([1.0e-4, 5.8e-5, 1.2e-4]),
}
PENDULUM = {
    "middle": (0.0,),
    "reach": (2.2,),
    "speed": (7.0,),
    "gain": (4.0,),
    "dither": (0.2,),
    "encoder_step": np.array([2e-4]),
}

#: file -> mechanism, effects that the published model lacks, seed, motion
LOGS = {
    "arm_nothing_missing.csv": ("puma560", (), 3, ARM),
    "arm_hidden_effect.csv": ("puma560", ("asymmetric_coulomb_friction:joint=2,positive=12.6,negative=7.1",), 5, ARM),
    "pendulum.csv": ("pendulum", ("coulomb_friction:joint=1,torque=0.03",), 7, PENDULUM),
}


def make(folder: Path) -> None:
    """Write all files of the examples into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (plant, effects, seed, motion) in LOGS.items():
        write(folder / name, *record(plant, effects, seed, **motion))
    time = np.arange(0.0, 5.0, 0.028)
    write(folder / "volts.csv", time, 10.0 * np.sin(np.outer(time, (1.0, 2.0, 3.0))))


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
