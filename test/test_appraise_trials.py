# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Trials: the kernel, an object and a stepper from outside give the same; every way to fail is a result."""

from dataclasses import replace

import numpy as np
import pytest

from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.controllers import make
from puma_sim_core.appraisal.perturbations.drawing import Conditions
from puma_sim_core.appraisal.trials.trial import Trial
from puma_sim_core.errors import ParameterError
from puma_sim_core.recording.recording import Recording
from puma_sim_core.simulation.simulator import Simulator

SETTING = Battery(("pid",), "quick").setting
ARM = SETTING.nominal.arm
TASK = SETTING.tasks["simultaneous_steps"]


def conditions(name: str, draw: int = 0) -> Conditions:
    return SETTING.drawing.conditions(name, draw, 0.5 * TASK.duration)


def same(one, other) -> bool:
    names = ("time", "reference", "position", "velocity", "current")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


@pytest.mark.parametrize(
    "name",
    ["nominal", "parameters", "payload", "quantisation", "delay", "coulomb_friction:2:large", "backlash:3:large"],
)
def test_a_servo_gives_the_same_bits_in_the_kernel_and_as_an_object(name):
    made, given = make("ziegler_nichols", SETTING.models), conditions(name)
    inside = Trial(TASK, given, ARM, made.period).run_compiled(made.servo)
    assert inside is not None
    assert same(inside, Trial(TASK, given, ARM, made.period).run(made.controller))


@pytest.mark.parametrize("name", ["nominal", "noise", "jitter", "dropped", "all", "sensor_lag:1:large"])
def test_a_stepper_from_outside_gives_the_same_bits_as_an_object(name):
    made, given = make("computed_torque", SETTING.models), conditions(name)
    trial, controller = Trial(TASK, given, ARM, made.period), made.controller
    controller.reset()
    samples = trial.samples()
    asked = next(samples)
    with pytest.raises(StopIteration):
        while True:
            asked = samples.send(list(controller.update(*asked)))
    assert same(trial.response(), Trial(TASK, given, ARM, made.period).run(controller))


class Steady:
    def __init__(self, period, volts):
        self.period, self.volts = period, volts

    def reset(self):
        pass

    def update(self, t, setpoint, measurement):
        return self.volts(t)


@pytest.mark.parametrize("samples", [1, 4, 15, 28, 30, 60])
def test_any_whole_part_of_a_setpoint_period_is_a_period(samples):
    """The plant's answer to a voltage is that of `Simulator.run`, whatever the controller's period is."""
    period = 0.028 / samples
    trial = Trial(TASK, conditions("nominal"), ARM, period)
    response = trial.run(Steady(period, lambda t: (5.0 * t, -6.0, 2.0)))
    assert not response.failed
    simulator = Simulator(SETTING.nominal)
    simulator.reset(TASK.start)
    time = np.arange(0, len(response.time), trial.rows) * trial.step
    volts = np.column_stack([5.0 * time, np.full(len(time), -6.0), np.full(len(time), 2.0)])
    run: Recording = simulator.run(time, volts)
    assert np.allclose(response.position[:: trial.rows], run.position, rtol=0.0, atol=1e-9)


def test_a_period_that_is_no_part_of_a_setpoint_period_is_refused():
    with pytest.raises(ParameterError, match="whole part of the 0.028 s"):
        Trial(TASK, conditions("nominal"), ARM, 0.003)


def late_by(response, command) -> int:
    """Rows by which a step of the voltage at row 300 comes late."""
    return int(np.flatnonzero(response.applied[:, 0] == command)[0]) - 300


def test_jitter_and_lost_samples_reach_the_plant_as_drawn():
    step = Steady(0.028 / 30.0, lambda t: (1.0 if t > 299.5 * 0.028 / 30.0 else 0.0, 0.0, 0.0))
    given = replace(conditions("nominal"), jitter=0.02, stream=(3, 1, 4))
    delays = {
        late_by(Trial(TASK, replace(given, stream=(3, 1, k)), ARM, step.period).run(step), 1.0) for k in range(30)
    }
    # the first of all samples behind the step to arrive: soon, but seldom at once
    assert min(delays) >= 0 and max(delays) <= 0.02 * 30.0 / 0.028 and len(delays) > 2
    ramp = Steady(0.028 / 30.0, lambda t: (t, 0.0, 0.0))
    lost = Trial(TASK, replace(conditions("nominal"), dropped=0.1), ARM, ramp.period).run(ramp)
    held = float(np.mean(np.diff(lost.applied[:-1, 0]) == 0.0))
    assert 0.07 < held < 0.13


def test_lost_commands_are_no_voltage_and_a_push_is_added():
    task, steady = SETTING.tasks["command_loss"], Steady(0.028, lambda t: (3.0, 3.0, 3.0))
    response = Trial(task, conditions("nominal"), ARM, steady.period).run(steady)
    (begin, after), time = task.lost[0], response.time
    inside = (time >= begin - 1e-9) & (time < after - 1e-9)
    assert (response.applied[inside] == 0.0).all() and (response.applied[~inside] == 3.0).all()
    pushed = SETTING.tasks["load_step"]
    response = Trial(pushed, conditions("nominal"), ARM, steady.period).run(steady)
    assert np.allclose(response.applied[-1], 3.0 + np.array(pushed.pushes[0].voltage))


@pytest.mark.parametrize(
    ("volts", "end", "why"),
    [
        (lambda t: (float("nan"), 0.0, 0.0), "not_finite", "nan"),
        (lambda t: (0.0, 0.0), "refused", "not three numbers"),
        (lambda t: ("a", 0.0, 0.0), "refused", "not three numbers"),
        (lambda t: None, "refused", "None"),
        (lambda t: [0.0] * 100000, "refused", "100000 values"),
        (lambda t: {}[0], "refused", "KeyError"),
        (lambda t: (40.0, 40.0, 40.0), "limit", "outside"),
    ],
)
def test_a_controller_that_fails_ends_its_trial_with_the_reason(volts, end, why):
    task = SETTING.tasks["poses"]
    response = Trial(task, conditions("nominal"), ARM, 0.028).run(Steady(0.028, volts))
    assert response.end == end and why in response.why
    assert len(response.time) < task.duration / 0.028 * 30


def test_noise_follows_from_seed_name_and_draw_alone():
    made = make("pid", SETTING.models)
    runs = [Trial(TASK, conditions("noise", draw), ARM, made.period).run(made.controller) for draw in (0, 0, 1)]
    assert same(runs[0], runs[1]) and not same(runs[0], runs[2])
