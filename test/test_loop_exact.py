# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Exact positions are read as by an encoder; measured ones are left alone."""

from __future__ import annotations

import numpy as np

from puma_sim_core.loop.exact import as_measured
from puma_sim_core.loop.ingest import Log
from puma_sim_core.mechanisms import load_mechanism

PUMA = load_mechanism()
RANGES = np.array([high - low for low, high in PUMA.ranges])


def log_of(step=0.01, noise=0.0, quantum=0.0):
    time = np.arange(0.0, 10.0, step)
    position = np.sin(np.outer(time, [2.0, 3.1, 4.3])) + [0.0, -1.2, 1.3]
    position += noise * np.random.default_rng(1).normal(size=position.shape)
    if quantum:
        position = quantum * np.round(position / quantum)
    return Log("made", time, np.zeros_like(position), position)


def test_exact_positions_are_rounded_by_half_a_step_at_most():
    for step in (0.001, 0.01, 0.028):
        log = log_of(step)
        found, note = as_measured(log, PUMA)
        assert "all joints" in note
        off = np.abs(found.position - log.position).max(axis=0)
        assert np.all(off <= 0.5e-5 * RANGES * (1.0 + 1e-6)) and np.all(off > 0.4e-5 * RANGES)
        np.testing.assert_allclose(found.quantum, 1e-5 * RANGES, rtol=1e-12)
        assert found.voltage is log.voltage and found.time is log.time


def test_measured_positions_stay_as_they_are():
    for log in (log_of(noise=1e-3), log_of(0.001, quantum=1e-4)):
        found, note = as_measured(log, PUMA)
        assert found is log and note is None


def test_joints_are_judged_one_by_one():
    log = log_of()
    log.position[:, 1] += 1e-3 * np.random.default_rng(2).normal(size=len(log))
    found, note = as_measured(log, PUMA)
    assert "joints 1, 3" in note
    np.testing.assert_array_equal(found.position[:, 1], log.position[:, 1])
    assert found.quantum[1] == 0.0 and found.quantum[0] > 0.0
