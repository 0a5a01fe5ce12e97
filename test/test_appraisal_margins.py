# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Margins against python-control, known controllers, and each way of finding them against the other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import puma_sim_core as ps
from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.controllers import DoNothing
from puma_sim_core.appraisal.margins.linearisation import law_of, left_out, linear_margins, loop_margins, sampled_arm
from puma_sim_core.appraisal.margins.loop import injected_margins
from puma_sim_core.appraisal.margins.margins import MEASURES, NO_MARGINS, Margins, margin_measures, margins_of
from puma_sim_core.appraisal.margins.multisine import Injected, Multisine, injection_margins
from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.control.linear import pid_loop, radius
from puma_sim_core.errors import ParameterError
from puma_sim_core.servo.pid import Pid, PidGains
from puma_sim_core.servo.servo import DEFAULT_GAINS, ServoConfig
from puma_sim_core.simulation.simulator import Simulator

control = pytest.importorskip("control")

ARM = ps.load_parameters("bejczy")
PLANT = ps.Plant(ARM)
POSE = (0.2, -0.6, 0.3)
SAMPLE = 0.028 / 30.0
#: gains of the example controller over topics
EXTERNAL_PID = {
    "gain": [150.0, 260.0, 135.0],
    "integral_time": [0.15] * 3,
    "derivative_time": [0.02] * 3,
    "derivative_on_measurement": False,
}


def servo(period=SAMPLE, gains=DEFAULT_GAINS):
    return Pid(gains, period, limit=40.0, on_measurement=True)


def plant_with(*effects):
    return PLANT.with_effects(ps.parse_effect(text) for text in effects)


def assert_as_control_says(found, loop, frequency):
    gain, phase, _, _, gain_crossover, _ = control.stability_margins(loop)
    disk = control.disk_margins(loop, frequency)[0]
    S = control.frequency_response(control.feedback(1, loop), frequency).complex
    assert found.sensitivity_peak == pytest.approx(np.abs(S).max(), rel=1e-4)
    assert found.complementary_peak == pytest.approx(np.abs(1.0 - S).max(), rel=1e-4)
    assert found.gain_margin == pytest.approx(abs(20.0 * math.log10(gain)), rel=1e-4)
    assert found.phase_margin == pytest.approx(phase, rel=1e-4)
    assert found.delay_margin == pytest.approx(math.radians(phase) / gain_crossover, rel=1e-4)
    assert found.disk_margin == pytest.approx(disk, rel=1e-4)


@pytest.mark.parametrize(
    "numerator, denominator",
    [([25.0], [1.0, 10.0, 10.0, 10.0]), ([40.0], [1.0, 8.0, 16.0, 0.0]), ([6.0, 60.0], [1.0, 1.0, -10.0])],
)
def test_margins_of_a_loop_are_those_of_python_control(numerator, denominator):
    loop = control.sample_system(control.tf(numerator, denominator), 0.01)
    frequency = np.geomspace(0.01, math.pi / 0.01, 800)
    S = control.frequency_response(control.feedback(1, loop), frequency).complex
    assert_as_control_says(margins_of(frequency, S), loop, np.geomspace(0.05, math.pi / 0.01, 20001))


def test_a_loop_that_nothing_makes_unstable():
    # L = 0.2 / (s + 1): never as great as 1, its phase never at -180 degrees
    frequency = np.geomspace(1e-3, 1e3, 200)
    found = margins_of(frequency, 1.0 / (1.0 + 0.2 / (1j * frequency + 1.0)))
    assert found.gain_margin == found.phase_margin == found.delay_margin == math.inf
    assert found.sensitivity_peak == pytest.approx(1.0, abs=1e-6)


def test_loops_of_the_arm_are_those_of_python_control():
    # three coupled loops; each is broken by itself with the others closed
    arm, law = sampled_arm(PLANT, POSE, SAMPLE, 2), law_of(servo(), POSE, np.tile(POSE, (10, 1)))
    margins = loop_margins(arm, law, SAMPLE)
    open_loop = control.ss(*law, SAMPLE) * control.ss(*arm, SAMPLE)
    for j in range(3):
        others = np.diag([float(k != j) for k in range(3)])
        broken = control.feedback(open_loop, control.ss([], [], [], others, SAMPLE), sign=1)
        frequency = np.geomspace(0.05, math.pi / SAMPLE, 4001)
        z = np.exp(1j * frequency * SAMPLE)[:, None, None]
        A, B, C, D = broken.A, broken.B, broken.C, broken.D
        loop = -(D + C @ np.linalg.solve(z * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape))))[:, j, j]
        S = 1.0 / (1.0 + loop)
        assert margins[j].sensitivity_peak == pytest.approx(np.abs(S).max(), rel=1e-4)
        assert margins[j].disk_margin == pytest.approx((2.0 / np.abs((1.0 - loop) / (1.0 + loop))).min(), rel=1e-4)
        data = (np.abs(loop), np.degrees(np.unwrap(np.angle(loop))), frequency)
        gain, phase, _, _, crossover, _ = control.stability_margins(data)
        assert margins[j].gain_margin == pytest.approx(abs(20.0 * math.log10(gain)), rel=1e-3)
        assert margins[j].phase_margin == pytest.approx(phase, rel=1e-3)
        assert margins[j].delay_margin == pytest.approx(math.radians(phase) / crossover, rel=1e-3)


def test_the_law_of_a_pid_controller_is_found_from_its_answers():
    gains = (PidGains(900.0, 0.2, 0.03), PidGains(1600.0), PidGains(800.0, 0.5, 0.0))
    law = law_of(servo(gains=gains), POSE, np.tile(POSE, (20, 1)))
    # a sum and a difference of the first, none of the second, a sum of the third
    assert len(law.A) == 3
    frequency = np.geomspace(0.1, math.pi / SAMPLE, 50)
    for w in frequency:
        z = np.exp(1j * w * SAMPLE)
        found = law.D + law.C @ np.linalg.solve(z * np.eye(3) - law.A, law.B)
        expected = [
            -k.gain * (1.0 + SAMPLE / k.integral_time / (1.0 - 1.0 / z) + k.derivative_time / SAMPLE * (1.0 - 1.0 / z))
            for k in gains
        ]
        np.testing.assert_allclose(found, np.diag(expected), rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("delay", [0, 3])
def test_the_closed_loop_has_the_eigenvalues_of_the_servo_s_own(delay):
    # the gain that the PID law of `control.linear` says to be at the edge is so here too
    def stable(factor):
        gains = tuple(replace(g, gain=factor * g.gain) for g in DEFAULT_GAINS)
        law = law_of(servo(gains=gains), POSE, np.tile(POSE, (10, 1)))
        arm = sampled_arm(PLANT, POSE, SAMPLE, delay)
        return loop_margins(arm, law, SAMPLE) != (NO_MARGINS,) * 3

    arm = sampled_arm(PLANT, POSE, SAMPLE)
    F, G = arm.A[:9, :9], arm.B[:9]
    low, high = 1.0, 1000.0
    for _ in range(50):
        middle = math.sqrt(low * high)
        gains = [replace(g, gain=middle * g.gain) for g in DEFAULT_GAINS]
        inside = radius(pid_loop(F, G, gains, SAMPLE, delay)) < 1.0
        low, high = (middle, high) if inside else (low, middle)
    assert stable(0.999 * low) and not stable(1.001 * low)


def test_a_delay_of_the_input_takes_as_much_of_the_delay_margin():
    whole = linear_margins(PLANT, POSE, servo())
    for delay in (2.0 * SAMPLE, 2.4 * SAMPLE):
        late = linear_margins(plant_with(f"input_delay:time={delay!r}"), POSE, servo())
        for before, after in zip(whole, late):
            assert after.delay_margin < before.delay_margin and after.sensitivity_peak > before.sensitivity_peak
    two = linear_margins(plant_with(f"input_delay:time={2.0 * SAMPLE!r}"), POSE, servo())
    chained = linear_margins(PLANT, POSE, servo(), chain=ServoConfig(delay_samples=2))
    np.testing.assert_allclose(two, chained, rtol=1e-6)


def test_margins_are_where_the_loop_becomes_unstable():
    # more delay than the least delay margin makes the whole loop unstable, less does not
    least = min(margins.delay_margin for margins in linear_margins(PLANT, POSE, servo()))
    assert linear_margins(plant_with(f"input_delay:time={0.3 * least}"), POSE, servo())[0] != NO_MARGINS
    assert linear_margins(plant_with(f"input_delay:time={1.05 * least}"), POSE, servo())[0] == NO_MARGINS
    # the gain of one joint
    first = linear_margins(PLANT, POSE, servo())[0].gain_margin
    for change, stable in ((first - 0.2, True), (first + 0.2, False)):
        louder = replace(DEFAULT_GAINS[0], gain=DEFAULT_GAINS[0].gain * 10.0 ** (change / 20.0))
        law = law_of(servo(gains=(louder, *DEFAULT_GAINS[1:])), POSE, np.tile(POSE, (10, 1)))
        assert (loop_margins(sampled_arm(PLANT, POSE, SAMPLE), law, SAMPLE)[0] != NO_MARGINS) == stable


def injected(plant, controller, joint, design, setpoint_period=0.028, chain=ServoConfig()):
    signal = design.signal()
    with_signal = Injected(controller, joint, signal)
    simulator = Simulator(plant)
    simulator.reset(POSE)
    rows = math.ceil(len(signal) * controller.period / setpoint_period - 1e-9)
    simulator.run_controller(with_signal, np.tile(POSE, (rows, 1)), period=setpoint_period, chain=chain)
    return injection_margins(design, with_signal.answered[: len(signal)])


@pytest.mark.parametrize(
    "make, effects, chain",
    [
        (servo, (), ServoConfig()),
        (lambda: make_controller("computed_torque", ARM), ("payload:mass=2.0",), ServoConfig()),
        (lambda: make_controller("scheduled", ARM), ("input_delay:time=0.0025",), ServoConfig(delay_samples=1)),
        (lambda: servo(0.028, tuple(PidGains(150.0, 1.0, 0.02) for _ in range(3))), (), ServoConfig()),
    ],
    ids=["pid", "computed torque with a load", "scheduled and late", "every 28 ms"],
)
def test_linearisation_and_injection_agree(make, effects, chain):
    plant, controller = plant_with(*effects), make()
    exact = linear_margins(plant, POSE, controller, chain=chain)
    samples = 2 * round(1.4 / controller.period)
    joints = (1, 2, 3) if isinstance(controller, Pid) else (2,)
    for joint, expected in [(joint, exact[joint - 1]) for joint in joints]:
        lead = round(2.0 / controller.period)
        design = Multisine(controller.period, samples, rms=0.3, lead=lead, realisations=2, seed=joint)
        found = injected(plant, controller, joint, design, chain=chain)
        assert found.trusted
        np.testing.assert_allclose(found.margins, expected, rtol=0.05)


def test_a_loop_that_is_not_linear_is_not_trusted():
    design = Multisine(SAMPLE, 1500, rms=1.0, lead=1000, realisations=2)
    rough = injected(plant_with("coulomb_friction:joint=3,torque=4.0"), servo(), 3, design)
    assert not rough.trusted
    stuck = injected(plant_with("coulomb_friction:joint=3,torque=60.0"), servo(), 3, design)
    assert not stuck.trusted
    assert injected(PLANT, servo(), 3, design).trusted


class OneSided(Pid):
    """A controller that answers to errors of one sign."""

    def update(self, t, setpoint, measurement):
        error = np.subtract(setpoint, measurement)
        return super().update(t, np.where(error < 3e-6, measurement, setpoint), measurement)


class Alternating(Pid):
    """A controller that answers at every second sample."""

    def reset(self):
        super().reset()
        self._odd, self._held = False, (0.0, 0.0, 0.0)

    def update(self, t, setpoint, measurement):
        self._odd = not self._odd
        if self._odd:
            self._held = super().update(t, setpoint, measurement)
        return self._held


def test_controllers_that_are_not_linear_are_refused():
    for kind in (OneSided, Alternating):
        controller = kind(DEFAULT_GAINS, SAMPLE)
        with pytest.raises(ParameterError, match="a linear system misses by .*; expected a controller that is linear"):
            law_of(controller, POSE, np.tile(POSE, (11, 1)))
    with pytest.raises(ParameterError, match="a whole part of the 0.028 s between setpoints"):
        linear_margins(PLANT, POSE, servo(0.011))
    with pytest.raises(ParameterError, match="pose"):
        linear_margins(PLANT, (0.0, 1.0), servo())


def test_a_controller_without_any_answer_has_no_loop():
    nothing = Pid(tuple(PidGains(0.0) for _ in range(3)), SAMPLE)
    law = law_of(nothing, POSE, np.tile(POSE, (5, 1)))
    assert len(law.A) == 0 and not law.D.any()
    # without it the arm falls
    assert linear_margins(PLANT, POSE, nothing) == (NO_MARGINS,) * 3


def test_effects_that_a_linearisation_lacks_are_named():
    plant = plant_with("coulomb_friction:joint=1,torque=1.0", "payload:mass=1.0", "input_delay:time=0.001")
    assert left_out(plant) == ("coulomb_friction",)
    assert left_out(plant_with("viscous_friction:joint=2,coefficient=1.0")) == ()


def test_the_worst_joint_counts():
    good, bad = Margins(1.2, 1.1, 20.0, 80.0, 0.02, 1.4), Margins(1.5, 1.0, 15.0, 90.0, 0.01, 0.9)
    found = margin_measures([good, bad])
    assert list(found) == [one.name for one in MEASURES] == list(Margins._fields)
    assert tuple(found.values()) == (1.5, 1.1, 15.0, 80.0, 0.01, 0.9)
    assert tuple(margin_measures([good, NO_MARGINS]).values()) == tuple(one.worst for one in MEASURES)


def test_a_multisine_is_what_it_says():
    design = Multisine(SAMPLE, 1000, rms=0.7, lead=7, lowest=5.0, highest=100.0, realisations=3, seed=4)
    signal = design.signal()
    assert not signal[:7].any() and len(signal) == 7 + 6 * 1000
    periods = signal[7:].reshape(3, 2, 1000)
    np.testing.assert_array_equal(periods[:, 0], periods[:, 1])
    np.testing.assert_allclose(np.sqrt((periods**2).mean(axis=2)), 0.7, rtol=1e-12)
    spectrum = np.abs(np.fft.rfft(periods[0, 0]))
    excited = np.flatnonzero(spectrum > 1e-6)
    np.testing.assert_array_equal(excited, design.numbers)
    assert excited[0] / (1000 * SAMPLE) >= 5.0 - 1.1 and excited[-1] / (1000 * SAMPLE) <= 100.0 + 1.1
    np.testing.assert_array_equal(signal, replace(design).signal())
    assert not np.array_equal(signal, replace(design, seed=5).signal())


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"samples": 15}, "samples"),
        ({"samples": 101}, "even"),
        ({"rms": 0.0}, "rms"),
        ({"realisations": 1}, "realisations"),
        ({"lowest": 200.0, "highest": 100.0}, "four lines"),
    ],
)
def test_multisines_that_cannot_be_are_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        Multisine(**({"period": SAMPLE, "samples": 1000} | changes))


def test_a_trial_that_ended_early_has_no_margins():
    design = Multisine(SAMPLE, 1000)
    found = injection_margins(design, np.zeros(10))
    assert found.margins == NO_MARGINS and not found.trusted
    with pytest.raises(ParameterError, match="7000 samples; expected 6000"):
        injection_margins(design, np.zeros(7000))


@pytest.mark.parametrize("kind", ["pid", "scheduled", "computed_torque"])
def test_injection_as_an_appraisal_has_it_finds_its_own_period(kind):
    """Loops of 28 ms that cross over at 2 to 25 rad/s; what the linearisation leaves out is left out here, too."""
    setting = Battery(("pid",), "quick").setting
    task, arm = setting.tasks["margins"], setting.nominal.arm
    given = setting.drawing.conditions("all", 0, 1.0)
    settings = EXTERNAL_PID if kind == "pid" else load_settings(kind, "external")
    controller = make_controller(kind, setting.nominal, settings, 0.028, setpoint_period=0.028)
    exact = margin_measures(list(linear_margins(given.plant, task.start, controller)))
    found = injected_margins(task, given, arm, controller)
    assert found == pytest.approx(exact, rel=0.05)


def test_margins_that_cannot_be_trusted_are_none():
    setting = Battery(("pid",), "quick").setting
    task, arm = setting.tasks["margins"], setting.nominal.arm
    given = setting.drawing.conditions("nominal", 0, 1.0)
    assert injected_margins(task, given, arm, DoNothing()) == margin_measures([NO_MARGINS])
