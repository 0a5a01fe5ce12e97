# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Two measured rigs through the public `explain`, from files and without a word about either.

The geared pendulum of Rhoban/bam (Duclusaud, Passault and others, arXiv 2410.08650) and the
positioning system EMPS (Janot, Gautier and Brunot 2019).
"""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

DATA = os.environ.get("PUMA_SIM_DATA")
pytestmark = [
    pytest.mark.skipif(DATA is None, reason="PUMA_SIM_DATA names no folder"),
    pytest.mark.long,
    pytest.mark.timeout(1500),
]

PENDULUM = {"time": "t_s", "voltage1": "motor_V", "position1": "q_rad", "enable": "torque_enable"}
EMPS = {"time": "t_s", "voltage1": "vir_V", "position1": "q_meas_m"}
#: mean absolute error [rad] of q in free runs that the reference reaches, fitted to all eight runs:
#: viscous friction only, and friction of the gear that grows with the load
VISCOUS_ONLY, LOADED = 0.097, 0.053


def free_run_error(plant, path) -> float:
    """Mean absolute error of q [rad] of a whole run, from its first position at rest."""
    log = read_log(path, PENDULUM, 1)
    simulator = Simulator(plant)
    simulator.reset(log.position[0])
    run = simulator.run(log.time, log.voltage, enable=log.enable)
    return float(np.abs(run.position - log.position).mean())


def test_the_pendulum_lacks_friction_by_the_torque_that_its_gear_transmits():
    runs = sorted(Path(DATA, "xl330_pendulum").glob("*.csv"))
    assert len(runs) == 8
    # of each trajectory one run at one gain of the controller, the other one kept back
    fitted = [runs[i] for i in (0, 2, 5, 7)]
    kept = [runs[i] for i in (1, 3, 4, 6)]
    found = explain(
        [str(path) for path in fitted], held_out=[str(path) for path in kept], plant="pendulum", columns=PENDULUM
    )
    first = found.effects[0]
    assert (first.name, first.joint) == ("load_dependent_friction", 1)
    # of the motor's torque or of what the teeth bear, which is nearly all of it, not of the weight
    assert first.parameters["transmitted"].value > 0.5
    assert 0.4 < first.parameters["coefficient"].value < 0.65
    for before_after, share in (
        (found.errors["held_out_logs"].voltage_rms, 0.8),
        # as much as the reference's law takes away of its free runs
        (found.errors["held_out_logs"].position_rms, LOADED / VISCOUS_ONLY),
    ):
        assert before_after.augmented[0] < share * before_after.retuned[0]
    errors = {path: free_run_error(found.model, path) for path in runs}
    assert np.mean([errors[path] for path in kept]) < 0.085 < VISCOUS_ONLY
    # fitted to four runs, at all eight
    assert np.mean(list(errors.values())) < 1.3 * LOADED


@pytest.mark.thorough
def test_emps_lacks_friction_that_differs_by_direction():
    path = Path(DATA, "emps", "emps_train.csv")
    found = explain(str(path), plant="slide", columns=EMPS)
    (effect,) = found.effects
    assert effect.name == "asymmetric_coulomb_friction"
    # published: 20.394 N and an offset of -3.165 N, which are 17.2 and 23.6 N
    for name, published in (("positive", 17.2), ("negative", 23.6)):
        level = effect.parameters[name]
        assert abs(level.value - published) < 0.06 * published
        assert level.high - level.low < 0.15 * published
    # in shares of the force's norm: published 18.0 % with viscous friction only, 3.1 % by direction
    size = np.sqrt((read_log(path, EMPS, 1).voltage ** 2).mean())
    left = found.errors["held_out"].voltage_rms
    assert 0.15 < left.retuned[0] / size < 0.20
    assert left.augmented[0] / size < 0.05
    windows = found.errors["held_out"].position_rms
    assert windows.augmented[0] < 0.3 * windows.retuned[0]


@pytest.mark.parametrize("record, doubted", [("r01_A", ["voltage3"]), ("r03_A", [])])
def test_a_log_far_from_the_model_is_not_refused_for_its_rows(tmp_path, record, doubted):
    """Of another generator: a current limit holds the servo at its clip for long, or a delay swings it to and fro."""
    path = tmp_path / f"{record}.csv"
    path.write_bytes(gzip.decompress(Path(DATA, "other_generator", f"{record}.csv.gz").read_bytes()))
    log = read_log(path)
    found = check(log, load_mechanism())
    assert found.faults == found.cuts == () and [len(part) for part in found.parts] == [len(log)]
    assert [fault.channel for fault in found.doubts] == doubted


def test_a_log_of_another_machine_is_refused():
    """The positions of a pendulum are no positions of a slide."""
    path = sorted(Path(DATA, "xl330_pendulum").glob("*.csv"))[-1]
    found = explain(str(path), plant="slide", columns=PENDULUM)
    assert found.verdict == "DATA_FAULT" and "outside the joint's range" in found.sentence
