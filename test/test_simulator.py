# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The simulator's promises to its callers: rows, steps, limits, errors, and equal reruns."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from arm_reference import START, VISCOUS, bits, plant_of, smooth_voltages
from hypothesis import given, settings
from hypothesis import strategies as st

from puma_sim_core.errors import LimitError, NonFiniteStateError, ParameterError
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint, Limits
from puma_sim_core.simulation.run_inputs import GREATEST_STEP, check_step
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

#: every kind of effect at once
EFFECTS = (
    *VISCOUS,
    "coulomb_friction:joint=1,torque=12",
    "asymmetric_coulomb_friction:joint=2,positive=13.6,negative=7.65",
    "stribeck_friction:joint=2,torque=5",
    "presliding_friction:joint=3,torque=6",
    "voltage_saturation:joint=1,voltage=24",
    "current_limit:joint=3,current=3",
    "soft_stop:joint=1,lower=-0.2,upper=0.3",
    "payload:mass=1.5",
)
NOTHING = (0.0, 0.0, 0.0)


def simulator_of(*effects, start=START, **options):
    simulator = Simulator(plant_of(*effects), **options)
    simulator.reset(*start)
    return simulator


def state_of(recording, row=-1):
    return np.concatenate([recording.position[row], recording.velocity[row], recording.current[row]])


# ------------------------------------------------------------------------------ rows and steps


@pytest.mark.parametrize("effects", [(), VISCOUS, EFFECTS], ids=["none", "viscous", "all"])
def test_a_run_equals_repeated_steps_bit_for_bit(effects):
    time, volts = smooth_voltages((9.0, 12.0, 6.0), 1.0)
    run = simulator_of(*effects).run(time, volts)
    stepped = simulator_of(*effects)
    assert bits(stepped.state) == bits(state_of(run, 0))
    for row, duration in enumerate(np.diff(time)):
        state = stepped.step(volts[row], duration)
        assert bits(state) == bits(state_of(run, row + 1)) == bits(stepped.state)


@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["none", "all"])
def test_equal_runs_are_equal_bit_for_bit(effects):
    time, volts = smooth_voltages((9.0, 12.0, 6.0), 1.0)
    first, second = (simulator_of(*effects).run(time, volts) for _ in range(2))
    again = simulator_of(*effects)
    again.run(time, volts[::-1])
    again.reset(*START)
    third = again.run(time, volts)
    for other in (second, third):
        assert bits(first.position) == bits(other.position)
        assert bits(first.velocity) == bits(other.velocity)
        assert bits(first.current) == bits(other.current)


def test_the_voltage_of_a_row_holds_until_the_next_and_the_last_acts_on_nothing():
    time = np.array([0.5, 0.6, 0.7])
    volts = np.array([(5.0, 6.0, 7.0), (-5.0, 6.0, 0.0), (1.0, 1.0, 1.0)])
    run = simulator_of().run(time, volts)
    other = simulator_of().run(time, np.vstack([volts[:2], [(40.0, 40.0, 40.0)]]))
    assert bits(run.position) == bits(other.position)
    assert (run.time == time).all() and (run.voltage == volts).all()
    assert bits(state_of(run, 0)) == bits(np.concatenate(START))


def test_outputs_are_sampled_at_the_times_of_the_rows():
    # unequal rows, whole multiples of a step: the same states as with a row a step
    step = 1.0 / 1024
    edges = np.array([0, 3, 4, 20, 21, 64]) * step
    volts = np.tile((5.0, 6.0, -7.0), (6, 1))
    coarse = simulator_of(max_step=step).run(edges, volts)
    fine_time = np.arange(65) * step
    fine = simulator_of(max_step=step).run(fine_time, np.tile(volts[0], (65, 1)))
    rows = (edges / step).astype(int)
    assert bits(coarse.position) == bits(fine.position[rows])


@given(duration=st.floats(1e-4, 0.2), max_step=st.floats(2e-4, GREATEST_STEP))
@settings(max_examples=50)
def test_steps_inside_a_row_are_equal_and_at_most_max_step(duration, max_step):
    # voltages alone on a held arm: the current after n steps of h is the stability polynomial's
    simulator = Simulator(plant_of(), constraints=(Constraint("hold"),) * 3, max_step=max_step)
    simulator.reset(current=(1.0, 0.0, 0.0))
    simulator.step(NOTHING, duration)
    n = max(1, math.ceil(duration / max_step * (1.0 - 1e-6)))
    z = -1.6 / 0.0048 * duration / n
    factor = 1.0 + z + z**2 / 2 + z**3 / 6 + z**4 / 24
    assert simulator.state[6] == pytest.approx(factor**n, rel=1e-9, abs=1e-12)


def test_time_goes_on_with_steps_and_runs():
    simulator = simulator_of()
    assert simulator.time == 0.0
    simulator.step(NOTHING, 0.25)
    assert simulator.time == 0.25
    simulator.run([3.0, 4.0], np.zeros((2, 3)))
    assert simulator.time == 4.0
    simulator.reset(time=7.0)
    assert simulator.time == 7.0 and simulator.state == (0.0,) * 9


def test_a_run_of_one_row_is_the_start():
    run = simulator_of().run([2.0], [NOTHING], acceleration=True)
    assert bits(state_of(run)) == bits(np.concatenate(START))
    assert run.acceleration.shape == (1, 3) and np.isfinite(run.acceleration).all()


def test_reset_is_at_rest_without_current_unless_told():
    simulator = simulator_of()
    simulator.step((5.0, 5.0, 5.0), 0.1)
    simulator.reset((0.1, 0.2, 0.3))
    assert simulator.state == (0.1, 0.2, 0.3, *NOTHING, *NOTHING)
    assert simulator.bristles == NOTHING


def test_reset_forgets_the_bristles():
    simulator = simulator_of("presliding_friction:joint=1,torque=10", start=(NOTHING,))
    simulator.step((0.5, 0.0, 0.0), 0.1)
    assert simulator.bristles[0] != 0.0
    simulator.reset()
    assert simulator.bristles == NOTHING


# --------------------------------------------------------------------------------- digital servo


def test_servo_run_records_voltage_and_setpoint_of_each_sample():
    setpoint = np.array([[0.0, -1.0, 0.5], [0.01, -1.0, 0.5], [0.02, -1.01, 0.5]])
    simulator = simulator_of(start=(setpoint[0],))
    run = simulator.run_servo(setpoint, ServoConfig())
    assert len(run) == 91
    assert run.time[-1] == pytest.approx(0.084)
    assert (run.setpoint[:90] == np.repeat(setpoint, 30, axis=0)).all()
    again = simulator_of(start=(setpoint[0],))
    for row in range(90):
        again.step(run.voltage[row], SERVO_PERIOD)
        np.testing.assert_allclose(again.state, state_of(run, row + 1), rtol=0, atol=1e-13)
    assert np.abs(run.voltage).max() <= 40.0


def test_servo_holds_the_arm_at_its_setpoint():
    target = np.array([0.2, -0.7, 0.9])
    simulator = simulator_of("coulomb_friction:joint=2,torque=3", start=((0.15, -0.75, 0.85),))
    run = simulator.run_servo(np.tile(target, (150, 1)), ServoConfig())
    np.testing.assert_allclose(run.position[-1], target, atol=2e-4)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"setpoint": [[0.0, 0.0]]}, r"setpoint of shape \(1, 2\)"),
        ({"setpoint": [[0.0, 0.0, math.nan]]}, "finite"),
        ({"setpoint": np.zeros((0, 3))}, "no setpoint"),
        ({"samples": 0}, "samples 0; expected a whole number"),
        ({"samples": 1.5}, "samples 1.5; expected a whole number"),
        ({"period": -0.028}, "expected"),
        ({"period": math.nan}, "expected"),
        ({"voltage_limit": -1.0}, "voltage_limit -1.0 V; expected a positive number"),
        ({"voltage_limit": math.nan}, "voltage_limit nan V"),
    ],
)
def test_servo_arguments_that_cannot_be_used_are_refused(arguments, message):
    simulator = simulator_of()
    with pytest.raises(ParameterError, match=message):
        simulator.run_servo(**{"setpoint": np.zeros((1, 3)), **arguments})
    assert bits(simulator.state) == bits(np.concatenate(START)) and simulator.time == 0.0


# ---------------------------------------------------------------------------------------- limits


def test_limits_report_joint_quantity_time_and_value():
    limits = Limits(
        position=((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)), velocity=(10.0, 0.1, 10.0), acceleration=(1e6, 1e6, 1e6)
    )
    simulator = simulator_of(start=(NOTHING,), limits=limits)
    time = np.arange(0.0, 1.0, 0.01)
    run = simulator.run(time, np.tile((30.0, 0.0, 0.0), (100, 1)))
    first = time[np.argmax(run.position[:, 0] > 1.0)]
    found = simulator.exceeded
    value = run.position[run.time == first, 0][0]
    assert any(f"joint 1: position {value:.7g} rad at {first:.6g} s is outside -1 to 1" in text for text in found)
    assert any("joint 2: velocity" in text and "rad/s" in text for text in found)
    assert not any("acceleration" in text or "joint 3: velocity" in text for text in found)
    simulator.reset()
    simulator.run([0.0, 0.01], np.zeros((2, 3)))
    assert simulator.exceeded == []


def test_a_limit_may_be_an_error():
    limits = Limits(acceleration=(1.0, 1e9, 1e9))
    simulator = simulator_of(start=(NOTHING,), limits=limits, on_limit="error")
    message = "joint 1: acceleration .* rad/s.2 at .* s is outside -1 to 1"
    with pytest.raises(LimitError, match=message):
        simulator.run(np.arange(0.0, 0.1, 0.01), np.tile((40.0, 0.0, 0.0), (10, 1)))
    with pytest.raises(ParameterError, match="on_limit 'stop'; expected report or error"):
        Simulator(plant_of(), on_limit="stop")


# ---------------------------------------------------------------------------------------- errors


def test_a_step_above_8_ms_is_refused():
    assert check_step(0.008) == 0.008
    Simulator(plant_of(), max_step=0.008)
    for step in (0.008001, 0.05, 0.0, -0.001, math.nan, math.inf):
        with pytest.raises(ParameterError, match="max_step: .* ms; expected .* at most 8 ms"):
            Simulator(plant_of(), max_step=step)


def test_runge_kutta_is_stable_at_8_ms_and_not_at_9():
    # what the refusal above rests on: the circuit's polynomial passes 1 at h R/L = 2.785
    def growth(h):
        z = -1.6 / 0.0048 * h
        return abs(1.0 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)

    assert growth(0.008) < 1.0 < growth(0.009)
    simulator = simulator_of(max_step=0.008)
    simulator.step((1.0, 1.0, 1.0), 4.0)
    assert np.abs(simulator.state[3:]).max() < 5.0


@pytest.mark.parametrize(
    "time, voltage, message",
    [
        ([0.0, 1.0], [NOTHING], "shape"),
        ([[0.0]], [NOTHING], "shape"),
        ([], np.zeros((0, 3)), "shape"),
        ([0.0, 1.0], np.zeros((2, 2)), "shape"),
        ([0.0, 0.0], np.zeros((2, 3)), "times that do not increase"),
        ([1.0, 0.0], np.zeros((2, 3)), "times that do not increase"),
        ([0.0, math.inf], np.zeros((2, 3)), "not finite"),
        ([0.0, 1.0], [NOTHING, (0.0, math.nan, 0.0)], "not finite"),
    ],
)
def test_rows_that_cannot_be_run_are_refused_before_anything_moves(time, voltage, message):
    simulator = simulator_of()
    with pytest.raises(ParameterError, match=message):
        simulator.run(time, voltage)
    assert bits(simulator.state) == bits(np.concatenate(START))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda s: s.step((0.0, 0.0), 0.1), r"voltage = .*; expected three finite numbers"),
        (lambda s: s.step((0.0, 0.0, math.nan), 0.1), "voltage"),
        (lambda s: s.step("abc", 0.1), "voltage"),
        (lambda s: s.step(NOTHING, 0.0), "duration 0.0 s; expected a positive number"),
        (lambda s: s.step(NOTHING, math.inf), "duration inf s"),
        (lambda s: s.reset((0.0, 0.0)), "position"),
        (lambda s: s.reset(NOTHING, (0.0, 0.0, math.inf)), "velocity"),
        (lambda s: s.reset(NOTHING, NOTHING, None), "current"),
    ],
)
def test_numbers_that_cannot_be_used_are_refused(call, message):
    simulator = simulator_of()
    with pytest.raises(ParameterError, match=message):
        call(simulator)
    assert bits(simulator.state) == bits(np.concatenate(START)) and simulator.time == 0.0


@pytest.mark.parametrize(
    "text, constraint",
    [
        ("free", Constraint()),
        ("hold", Constraint("hold")),
        ("velocity", Constraint("velocity")),
        ("velocity:0.5", Constraint("velocity", 0.5)),
        ("acceleration:-1", Constraint("acceleration", -1)),
    ],
)
def test_constraints_are_read_from_text(text, constraint):
    assert Constraint.parse(text) == constraint
    assert constraint.value is None or type(constraint.value) is float


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "constraint ''"),
        ("fixed", "constraint 'fixed'; expected free or hold"),
        ("hold:1", "constraint 'hold': value 1.0; expected no value"),
        ("acceleration", "no value"),
        ("velocity:", "value ''; expected a number"),
        ("velocity:x", "value 'x'; expected a number"),
        ("velocity:nan", "value nan; expected a finite number"),
        ("acceleration:inf", "value inf; expected a finite number"),
    ],
)
def test_constraints_that_cannot_be_used_are_named(text, message):
    with pytest.raises(ParameterError, match=message):
        Constraint.parse(text)


def test_constraints_come_in_threes_and_agree_with_the_initial_velocity():
    with pytest.raises(ParameterError, match="expected one Constraint a joint"):
        Simulator(plant_of(), constraints=(Constraint(),))
    with pytest.raises(ParameterError, match="expected one Constraint a joint"):
        Simulator(plant_of(), constraints=("hold", "hold", "hold"))
    with pytest.raises(ParameterError, match="value True; expected a finite number"):
        Constraint("velocity", True)
    simulator = Simulator(plant_of(), constraints=(Constraint("hold"), Constraint("velocity", 0.5), Constraint()))
    with pytest.raises(ParameterError, match="initial velocity 1.0 rad/s of joint 1; expected 0.0"):
        simulator.reset(velocity=(1.0, 0.0, 0.0))
    with pytest.raises(ParameterError, match="of joint 2; expected 0.5 rad/s"):
        simulator.reset(velocity=(0.0, 0.4, 0.0))


EXPLOSION = """
import numpy as np
from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator
simulator = Simulator(Plant.of())
volts = np.zeros((50, 3))
volts[4:] = 1e160
try:
    simulator.run(1.0 + 0.01 * np.arange(50), volts)
except NonFiniteStateError as error:
    print(error.step, repr(simulator.time), *map(float.hex, simulator.state))
"""


@pytest.mark.parametrize("kernel", ["python", "numba"])
def test_a_state_that_stops_being_finite_leaves_the_last_finite_one(kernel):
    pytest.importorskip("numba") if kernel == "numba" else None
    import os

    run = subprocess.run(
        [sys.executable, "-c", EXPLOSION],
        capture_output=True,
        text=True,
        env={**os.environ, "PUMA_SIM_KERNEL": kernel},
        check=True,
    )
    step, time, *state = run.stdout.split()
    # rows 0 to 4 are still those of the arm that falls; the voltage of row 4 breaks row 5
    simulator = simulator_of(start=(NOTHING,))
    simulator.run(0.01 * np.arange(5), np.zeros((5, 3)))
    assert int(step) == 5 and float(time) == 1.0 + 0.01 * 4
    np.testing.assert_allclose([float.fromhex(x) for x in state], simulator.state, atol=1e-12)


def test_a_step_that_explodes_keeps_the_state_and_the_time():
    simulator = simulator_of()
    simulator.step(NOTHING, 0.01)
    state, time = simulator.state, simulator.time
    with pytest.raises(NonFiniteStateError, match="step 1: the state is no longer finite"):
        simulator.step((1e200, 0.0, 0.0), 0.1)
    assert bits(simulator.state) == bits(state) and simulator.time == time
    simulator.step(NOTHING, 0.01)
    assert np.isfinite(simulator.state).all()
