# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs without noise for the tests of the screening's columns, of exactly known states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.effects import parse_effect
from puma_sim_core.effects.screening import TORQUE_COLUMN, Signals
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

STEP = 5e-4
ARM = load_mechanism("puma560")
THETA = ARM.start
DRIVE = ARM.drive(THETA)


def reference(time):
    """Smooth motion of all joints with many reversals, slow and fast parts: q, qd, qdd (n, 3)."""
    parts = (
        ((0.45, 1.7, 0.3), (0.10, 6.9, 1.0), (0.012, 25.0, 0.0)),
        ((0.30, 1.3, 1.1), (0.09, 5.3, 0.2), (0.010, 29.0, 0.5)),
        ((0.40, 2.1, 2.0), (0.08, 7.7, 0.9), (0.012, 31.0, 1.5)),
    )
    middle = (0.2, -0.5, 1.0)
    q, qd, qdd = (np.zeros((len(time), 3)) for _ in range(3))
    for j, waves in enumerate(parts):
        q[:, j] = middle[j]
        for amplitude, w, phase in waves:
            q[:, j] += amplitude * np.sin(w * time + phase)
            qd[:, j] += amplitude * w * np.cos(w * time + phase)
            qdd[:, j] -= amplitude * w * w * np.sin(w * time + phase)
    return q, qd, qdd


def recorded(*effects: str, duration=4.0, change=None):
    """Recording of the arm, driven open loop near the reference by voltages every half millisecond.

    effects : in the text form; change : (n, 3) voltages -> voltages, before the run.
    """
    time = STEP * np.arange(int(round(duration / STEP)) + 1)
    q, qd, qdd = reference(time)
    voltage = ARM.model_voltage(THETA, q, qd, qdd)
    if change is not None:
        voltage = change(voltage)
    plant = ARM.plant(THETA, tuple(parse_effect(text) for text in effects))
    simulator = Simulator(plant)
    simulator.reset(position=q[0], velocity=qd[0], current=(voltage[0] - DRIVE.emf * qd[0]) / resistance())
    return simulator.run(time, voltage, acceleration=True)


def resistance():
    """(3,) [ohm]"""
    return np.array([m.resistance for m in ARM.arm.motors])


def torque_per_ampere():
    """(3,) N kt [N.m/A]"""
    return resistance() / DRIVE.volts_per_torque


def signals_of(time, voltage, q, qd, qdd, current=None, **fields) -> Signals:
    """Signals of exact states; voltage (n, 3): what was held from each time on."""
    held = voltage.copy()
    held[1:] = 0.5 * (voltage[1:] + voltage[:-1])
    link = ARM.torque(THETA, q, qd, qdd)
    total = link + DRIVE.motor_inertia * qdd + DRIVE.viscous * qd
    body = inertia(q, ARM.arm_of(THETA))
    made = Signals(
        time=time,
        step=float(time[1] - time[0]),
        segment=np.zeros(len(time), int),
        voltage=held,
        position=q,
        velocity=qd,
        acceleration=qdd,
        link_torque=link,
        gravity_torque=ARM.gravity(THETA, q),
        torque=total,
        current=total / torque_per_ampere() if current is None else current,
        enable=np.ones_like(q),
        link_inertia=np.diagonal(body, axis1=1, axis2=2).copy(),
        motor_inertia=DRIVE.motor_inertia,
        viscous=DRIVE.viscous,
        volts_per_torque=DRIVE.volts_per_torque,
        lag=DRIVE.lag,
        emf=DRIVE.emf,
        gear=ARM.gear,
        torque_scale=ARM.torque_scale,
        velocity_noise=np.full(3, 1e-6),
        quantum=np.zeros(3),
        ranges=ARM.ranges,
        gravity_tilt=ARM.gravity_tilt(THETA, q),
        payload_torque=lambda at: ARM.payload_torque(THETA, at, q, qd, qdd),
        inertia=body,
        position_gradient=gradient(q, qd, qdd),
        torque_per_ampere=torque_per_ampere(),
        library_sized=True,
    )
    return replace(made, **fields)


def gradient(q, qd, qdd, moved=1e-5):
    """(n, J, J) change of the link torque of joint i per rad of joint j, by central differences."""
    out = np.empty(q.shape + (3,))
    for j in range(3):
        by = np.zeros(3)
        by[j] = moved
        out[:, :, j] = (ARM.torque(THETA, q + by, qd, qdd) - ARM.torque(THETA, q - by, qd, qdd)) / (2.0 * moved)
    return out


def signals_with(*effects: str, duration=4.0, change=None) -> Signals:
    """Signals of the arm with effects, from the states of its motors."""
    r = recorded(*effects, duration=duration, change=change)
    return signals_of(r.time, r.voltage, r.position, r.velocity, r.acceleration)


def residual(signals: Signals) -> np.ndarray:
    """V - Vhat (n, 3)."""
    torque = signals.torque
    rate = np.gradient(torque, signals.step, axis=0, edge_order=2)
    return signals.voltage - (signals.volts_per_torque * (torque + signals.lag * rate) + signals.emf * signals.velocity)


def volts(signals: Signals, candidate, coefficients) -> np.ndarray:
    """(n, 3) voltages of a candidate with its coefficients, as the screening takes them."""
    out = np.zeros_like(signals.position)
    for column, c in zip(candidate.columns, coefficients):
        for j, values in column.items():
            if candidate.unit == TORQUE_COLUMN:
                values = signals.volts_per_torque[j] * (
                    values + signals.lag[j] * np.gradient(values, signals.step, edge_order=2)
                )
            out[:, j] += c * values
    return out


def smoothed(values, signals, cutoff=25.0):
    """Values through the screening's kind of second filter: a low pass without shift in time."""
    from scipy.signal import butter, sosfiltfilt

    return sosfiltfilt(butter(3, cutoff, fs=1.0 / signals.step, output="sos"), values, axis=0)
