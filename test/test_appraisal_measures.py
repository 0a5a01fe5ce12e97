# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Measures of a trial against closed forms, python-control and examples of ISO 9283 that were worked by hand."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

import puma_sim_core as ps
from puma_sim_core.appraisal.measures import MEASURES, expected_measures, measure, measure_repeats
from puma_sim_core.appraisal.trials.response import ENDS, Aims, Path, Response, Step, Stop
from puma_sim_core.arm.inverse_kinematics import wrist_angles
from puma_sim_core.arm.kinematics import wrist_path
from puma_sim_core.errors import ParameterError

control = pytest.importorskip("control")

ARM = ps.load_parameters("bejczy")
SAMPLE = 0.028 / 30.0
HOME = np.array([0.2, -0.6, 0.3])


def response(time, position, velocity, reference=None, **further):
    """A trial of which the motion alone matters."""
    nothing = np.zeros((len(time), 3))
    columns = {"voltage": nothing, "applied": nothing, "current": nothing, "arm": ARM} | further
    return Response(time, nothing if reference is None else reference, position, velocity, **columns)


def second_order(zeta, omega, dead=0.0):
    """(y, y') of a unit step through omega^2 e^(-dead s) / (s^2 + 2 zeta omega s + omega^2)."""
    root = math.sqrt(1.0 - zeta * zeta)

    def y(t):
        t = np.maximum(np.asarray(t) - dead, 0.0)
        phase = omega * root * t
        return 1.0 - np.exp(-zeta * omega * t) * (np.cos(phase) + zeta / root * np.sin(phase))

    def rate(t):
        t = np.maximum(np.asarray(t) - dead, 0.0)
        return omega / root * np.exp(-zeta * omega * t) * np.sin(omega * root * t)

    return y, rate


@pytest.mark.parametrize("zeta, omega, dead", [(0.3, 12.0, 0.0), (0.6, 20.0, 0.028), (0.45, 8.0, 0.0101)])
def test_a_second_order_response_with_dead_time(zeta, omega, dead):
    y, rate = second_order(zeta, omega, dead)
    at, size, duration = 50 * SAMPLE, -0.2, 2000 * SAMPLE
    time = SAMPLE * np.arange(2051)
    position, velocity, reference = np.zeros((3, len(time), 3))
    since = time - at
    # rounding must not move the step by a row
    reference[:, 1] = 0.5 + size * (since > -1e-9)
    position[:, 1], velocity[:, 1] = 0.5 + size * y(since), size * rate(since)
    found = measure(response(time, position, velocity, reference), Aims(steps=[Step(2, at, 0.5, 0.5 + size)]))

    peak = dead + math.pi / (omega * math.sqrt(1.0 - zeta**2))
    cross = [brentq(lambda t, level=level: y(t) - level, dead, peak, xtol=1e-14) for level in (0.1, 0.9)]
    assert found["rise_time"] == pytest.approx(cross[1] - cross[0], abs=1e-6)
    assert found["overshoot"] == pytest.approx(math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), abs=1e-6)
    assert found["undershoot"] == 0.0
    turns = dead + math.pi / (omega * math.sqrt(1.0 - zeta**2)) * np.arange(1, 20)
    last = turns[np.abs(y(turns) - 1.0) > 0.02][-1]
    settled = brentq(lambda t: abs(y(t) - 1.0) - 0.02, last, last + turns[1] - turns[0], xtol=1e-14)
    assert found["settling_time"] == pytest.approx(settled, abs=1e-6)
    # between its zeros the error has one sign, so that no quadrature meets a kink
    crossings = [dead, *(brentq(lambda t: y(t) - 1.0, a, b) for a, b in zip([dead, *turns[:-1]], turns))]
    edges = [0.0, *(c for c in crossings if 0.0 < c < duration), duration]

    def integral(weight):
        return sum(quad(weight, a, b, epsabs=1e-13, limit=200)[0] for a, b in pairwise(edges))

    assert found["iae"] == pytest.approx(0.2 * integral(lambda t: abs(y(t) - 1.0)), rel=1e-6)
    assert found["ise"] == pytest.approx(0.04 * integral(lambda t: (y(t) - 1.0) ** 2), rel=1e-6)
    assert found["itae"] == pytest.approx(0.2 * integral(lambda t: (t + at) * abs(y(t) - 1.0)), rel=1e-6)
    assert found["greatest_error"] == pytest.approx(0.2, abs=1e-12)
    final = (duration + at - 0.1 * duration - at, duration)
    mean = quad(lambda t: y(t) - 1.0, *final, epsabs=1e-14)[0] / (0.1 * duration)
    assert found["steady_error"] == pytest.approx(abs(mean), abs=1e-6)


def test_samples_28_ms_apart_are_good_to_a_thousandth():
    y, rate = second_order(0.4, 12.0)
    time = 0.028 * np.arange(120)
    position, velocity = np.zeros((2, len(time), 3))
    position[:, 0], velocity[:, 0] = y(time), rate(time)
    reference = np.zeros_like(position) + (1.0, 0.0, 0.0)
    found = measure(response(time, position, velocity, reference), Aims(steps=[Step(1, 0.0, 0.0, 1.0)]))
    assert found["overshoot"] == pytest.approx(math.exp(-math.pi * 0.4 / math.sqrt(1.0 - 0.16)), abs=1e-4)
    assert found["ise"] == pytest.approx(quad(lambda t: (y(t) - 1.0) ** 2, 0.0, time[-1], limit=200)[0], rel=1e-3)


@pytest.mark.parametrize("zeros", [[1.0], [-0.1, 1.0]])
def test_step_measures_are_those_of_python_control(zeros):
    system = control.tf(np.array(zeros) * 25.0, [1.0, 4.0, 25.0])
    time = 1e-4 * np.arange(40001)
    values = control.step_response(system, time).y[0, 0]
    velocity = control.impulse_response(system, time).y[0, 0]
    position = np.zeros((len(time), 3))
    position[:, 2] = values
    rates = np.zeros_like(position)
    rates[:, 2] = velocity
    found = measure(response(time, position, rates), Aims(steps=[Step(3, 0.0, 0.0, 1.0)]))
    info = control.step_info(values, time, final_output=1.0)
    # step_info takes the nearest sample
    assert found["rise_time"] == pytest.approx(info["RiseTime"], abs=2e-4)
    assert found["settling_time"] == pytest.approx(info["SettlingTime"], abs=1e-4)
    assert found["overshoot"] == pytest.approx(info["Overshoot"] / 100.0, abs=1e-6)
    assert found["undershoot"] == pytest.approx(info["Undershoot"] / 100.0, abs=1e-6)


def test_effort_of_a_trial_worked_by_hand():
    # 1 s at 10 V, 1 s at -6 V, 2 s at 40 V of one joint; current 1, 2, 0, 3, -1 A at 0, 1, 2, 3, 4 s
    time = np.arange(5.0)
    applied, asked, current = np.zeros((3, 5, 3))
    applied[:, 0] = 10.0, -6.0, 40.0, 40.0, 40.0
    asked[:, 0] = 10.0, -6.0, 55.0, 40.0, 40.0
    current[:, 0] = 1.0, 2.0, 0.0, 3.0, -1.0
    rest = np.zeros((5, 3))
    found = measure(Response(time, rest, rest, rest, asked, applied, current, 40.0, ARM), Aims())
    assert found["voltage_rms"] == pytest.approx(math.sqrt((100.0 + 36.0 + 2 * 1600.0) / 4.0 / 3.0), rel=1e-12)
    assert found["voltage_variation"] == pytest.approx(16.0 + 46.0, rel=1e-12)
    # mean currents of the rows: 1.5, 1, 1.5, 1 A; the second row brakes
    assert found["energy"] == pytest.approx(15.0 + 0.0 + 60.0 + 40.0, rel=1e-12)
    # integrals of i^2: 7/3, 4/3, 3, 7/3
    assert found["current_rms"] == pytest.approx(math.sqrt(9.0 / 4.0 / 3.0), rel=1e-12)
    assert found["saturated_share"] == pytest.approx(0.5)


def moving(time, points, velocities):
    """(position, velocity) of the joints, (n, 3) each, for a motion of the wrist (n, 3) [m], [m/s]."""
    q = np.empty((len(time), 3))
    near = HOME
    for row, point in enumerate(points):
        near = q[row] = wrist_angles(point, ARM, near)
    jacobians = np.stack([wrist_path(q + 1e-30j * np.eye(3)[j], ARM).imag / 1e-30 for j in range(3)], axis=-1)
    return q, np.linalg.solve(jacobians, np.asarray(velocities)[:, :, None])[:, :, 0]


def standing(*offsets, commanded=None):
    """A trial that stands for a second at each place (offsets from home [m]), commanded to be at home."""
    home = wrist_path(HOME, ARM)
    time = 0.01 * np.arange(100 * len(offsets) + 1)
    place = np.minimum((time + 1e-9).astype(int), len(offsets) - 1)
    q, qd = moving(time, home + np.asarray(offsets)[place], np.zeros((len(time), 3)))
    wanted = np.zeros((len(offsets), 3)) if commanded is None else np.asarray(commanded)
    reference, _ = moving(time, home + wanted[place], np.zeros((len(time), 3)))
    return response(time, q, qd, reference)


def test_pose_accuracy_and_repeatability_worked_by_hand():
    # three visits; barycentre (0, 0, 1) mm; distances from it sqrt 2, sqrt 2, sqrt 6 mm
    trial = standing((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (-1e-3, -1e-3, 3e-3))
    stops = [Stop(1, 1, k + 0.2, k + 0.9) for k in range(3)]
    found = measure(trial, Aims(stops=stops))
    assert found["pose_accuracy"] == pytest.approx(1e-3, abs=1e-9)
    # mean 1.7593056, deviations -0.3450921 (twice) and 0.6901841: S = 0.5977170
    assert found["pose_repeatability"] == pytest.approx(1.7593056e-3 + 3.0 * 0.5977170e-3, abs=1e-9)
    assert found["stabilisation_time"] == found["pose_overshoot"] == 0.0
    assert "multidirectional_variation" not in found and "distance_accuracy" not in found
    # the same from three trials of one visit each
    singles = [standing(offset) for offset in ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (-1e-3, -1e-3, 3e-3))]
    together = measure_repeats(singles, Aims(stops=[Stop(1, 1, 0.2, 0.9)]))
    assert together["pose_accuracy"] == pytest.approx(found["pose_accuracy"], abs=1e-12)
    assert together["pose_repeatability"] == pytest.approx(found["pose_repeatability"], abs=1e-12)
    assert "pose_repeatability" not in measure(singles[0], Aims(stops=[Stop(1, 1, 0.2, 0.9)]))


def test_approaches_and_distances_worked_by_hand():
    # pose 1 from direction 1 at (1, 0, 0) and (1, 0, 2) mm, from direction 2 at (-2, 4, 1) mm: sqrt(9 + 16) apart
    # pose 2 is 100 mm above pose 1; it is attained 2 and 4 mm too high
    offsets = np.array([(1, 0, 0), (1, 0, 102), (1, 0, 2), (1, 0, 106), (-2, 4, 1)]) * 1e-3
    wanted = np.array([(0, 0, 0), (0, 0, 100), (0, 0, 0), (0, 0, 100), (0, 0, 0)]) * 1e-3
    labels = [(1, 1), (2, 1), (1, 1), (2, 1), (1, 2)]
    stops = [Stop(*label, k + 0.2, k + 0.9) for k, label in enumerate(labels)]
    found = measure(standing(*offsets, commanded=wanted), Aims(stops=stops))
    assert found["multidirectional_variation"] == pytest.approx(5e-3, abs=1e-9)
    # distances: 1 -> 2: 102 and 104 mm: mean 3 mm too long, S = sqrt 2;
    # 2 -> 1 (direction 1): 100 mm; 2 -> 1 (direction 2): sqrt(9 + 16 + 105^2) = 105.1190 mm
    assert found["distance_accuracy"] == pytest.approx((math.sqrt(11050.0) - 100.0) * 1e-3, abs=1e-9)
    assert found["distance_repeatability"] == pytest.approx(3.0 * math.sqrt(2.0) * 1e-3, abs=1e-9)


def test_stabilisation_and_overshoot_of_a_decaying_vibration():
    # the wrist swings about its pose by 20 mm e^(-4 t) cos(30 t) from the arrival of the command on
    home, duration = wrist_path(HOME, ARM), 6.0
    time = SAMPLE * np.arange(int(duration / SAMPLE) + 1)

    def swing(t):
        return 0.02 * np.exp(-4.0 * t) * np.cos(30.0 * t)

    rate = -0.02 * np.exp(-4.0 * time) * (4.0 * np.cos(30.0 * time) + 30.0 * np.sin(30.0 * time))
    up = np.array([0.0, 0.0, 1.0])
    trial = response(
        time, *moving(time, home + swing(time)[:, None] * up, rate[:, None] * up), np.tile(HOME, (len(time), 1))
    )
    found = measure(trial, Aims(stops=[Stop(1, 1, 0.0, float(time[-1]), band=1e-3)]))
    entered = brentq(lambda t: swing(t) - 1e-3, 0.0, math.pi / 60.0, xtol=1e-14)
    turns = (math.pi * np.arange(1, 60) - math.atan(4.0 / 30.0)) / 30.0
    assert found["pose_overshoot"] == pytest.approx(abs(swing(turns[0])), rel=1e-6)
    last = turns[np.abs(swing(turns)) > 1e-3][-1]
    left = brentq(lambda t: abs(swing(t)) - 1e-3, last, last + math.pi / 60.0, xtol=1e-14)
    assert found["stabilisation_time"] == pytest.approx(left - entered, abs=1e-6)


def test_a_straight_path_worked_by_hand():
    # 0.2 m/s along y, 3 mm too high; attained 0.21 m/s and 0.205 m/s, starting 5 mm behind
    home = wrist_path(HOME, ARM)
    time = SAMPLE * np.arange(1501)
    along, up = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    reference, _ = moving(time, home + np.outer(0.2 * time, along), np.outer(0.2 + 0.0 * time, along))

    def trial(speed, height):
        points = home + np.outer(speed * time - 0.005, along) + height * up
        return response(time, *moving(time, points, np.outer(speed + 0.0 * time, along)), reference)

    aims = Aims(paths=[Path(1, 0.3, 1.1, 0.2)])
    found = measure(trial(0.21, 3e-3), aims)
    assert found["path_accuracy"] == pytest.approx(3e-3, abs=1e-8)
    assert found["path_speed_accuracy"] == pytest.approx(0.05, abs=1e-6)
    assert found["path_speed_fluctuation"] == pytest.approx(0.0, abs=1e-6)
    assert "path_repeatability" not in found
    # passes at 3 and at -1 mm: centre at 1 mm, both 2 mm from it; speeds 5 and 2.5 % too high
    found = measure_repeats([trial(0.21, 3e-3), trial(0.205, -1e-3)], aims)
    assert found["path_accuracy"] == pytest.approx(1e-3, abs=1e-8)
    assert found["path_repeatability"] == pytest.approx(2e-3, abs=1e-8)
    assert found["path_speed_accuracy"] == pytest.approx(0.0375, abs=1e-6)
    assert found["path_speed_repeatability"] == pytest.approx(3.0 * 0.025 / math.sqrt(2.0), abs=1e-6)


def test_a_path_that_speeds_up():
    # y = 0.2 t + 0.05 t^2 against 0.2 t: the plane at t is passed at s with 0.2 s + 0.05 s^2 = 0.2 t
    home = wrist_path(HOME, ARM) - (0.0, 0.15, 0.0)
    time, along = SAMPLE * np.arange(1501), np.array([0.0, 1.0, 0.0])
    reference, _ = moving(time, home + np.outer(0.2 * time, along), np.outer(0.2 + 0.0 * time, along))
    motion = moving(time, home + np.outer(0.2 * time + 0.05 * time**2, along), np.outer(0.2 + 0.1 * time, along))
    start, until = 300 * SAMPLE, 1200 * SAMPLE
    found = measure(response(time, *motion, reference), Aims(paths=[Path(1, start, until, 0.2)]))
    first, last = (0.2 + 0.1 * (-2.0 + 2.0 * math.sqrt(1.0 + t)) for t in (start, until))
    assert found["path_accuracy"] == pytest.approx(0.0, abs=1e-8)
    assert found["path_speed_fluctuation"] == pytest.approx(last - first, abs=1e-6)


def test_a_circle_with_another_radius():
    home = wrist_path(HOME, ARM)
    time, turn = SAMPLE * np.arange(2001), 2.0 * math.pi / (1500 * SAMPLE)

    def circle(radius, late=0.0):
        phase = turn * (time - late)
        e = np.stack([0.0 * phase, np.cos(phase), np.sin(phase)], axis=1)
        d = np.stack([0.0 * phase, -np.sin(phase), np.cos(phase)], axis=1)
        return moving(time, home + radius * e, radius * turn * d)

    reference = circle(0.10)[0]
    trial = response(time, *circle(0.098, 0.02), reference)
    found = measure(trial, Aims(paths=[Path(1, 200 * SAMPLE, 1600 * SAMPLE, 0.1 * turn)]))
    assert found["path_accuracy"] == pytest.approx(2e-3, abs=1e-7)
    assert found["path_speed_accuracy"] == pytest.approx(0.02, abs=1e-6)


def test_corners_worked_by_hand():
    # along y to the corner and then up, 0.1 m each at 0.1 m/s
    home = wrist_path(HOME, ARM)
    time = 1e-3 * np.arange(2001)
    y, z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])

    def cornered(first, second):
        return home + np.outer(first, y) + np.outer(second, z)

    reference, _ = moving(
        time, cornered(np.minimum(0.1 * time, 0.1), np.maximum(0.1 * time - 0.1, 0.0)), 0.0 * reference3(time)
    )
    aims = Aims(paths=[Path(1, 0.0, float(time[-1]), 0.1, corner=1.0)])
    # cut by a quarter of a circle of radius 20 mm, whose middle is 20 (sqrt 2 - 1) mm from the corner
    s = np.clip((time - 0.8) / 0.4, 0.0, 1.0) * 0.5 * math.pi
    first = np.where(s > 0.0, 0.08 + 0.02 * np.sin(s), 0.1 * time)
    second = np.where(s < 0.5 * math.pi, 0.02 * (1.0 - np.cos(s)), 0.02 + 0.1 * (time - 1.2))
    rates = np.gradient(np.stack([first, second]), time, axis=1)
    cut = response(
        time, *moving(time, cornered(first, second), np.outer(rates[0], y) + np.outer(rates[1], z)), reference
    )
    found = measure(cut, aims)
    assert found["corner_rounding"] == pytest.approx(0.02 * (math.sqrt(2.0) - 1.0), abs=1e-7)
    assert found["corner_overshoot"] == pytest.approx(0.0, abs=1e-6)
    # 7 mm beyond the corner and 1 mm to the side while it rises, as a cosine
    bump = 0.007 * np.sin(np.clip(time - 1.0, 0.0, 0.5) * 2.0 * math.pi) ** 2
    first = np.minimum(0.1 * time, 0.1) + bump
    second = np.maximum(0.1 * time - 0.1, 0.0)
    slope = 0.007 * 2.0 * math.pi * np.sin(np.clip(time - 1.0, 0.0, 0.5) * 4.0 * math.pi)
    rates = np.where(time < 1.0, 0.1, slope), np.where(time < 1.0, 0.0, 0.1)
    beyond = response(
        time, *moving(time, cornered(first, second), np.outer(rates[0], y) + np.outer(rates[1], z)), reference
    )
    found = measure(beyond, aims)
    assert found["corner_rounding"] == pytest.approx(0.0, abs=1e-6)
    assert found["corner_overshoot"] == pytest.approx(0.007, abs=1e-6)


def reference3(time):
    return np.zeros((len(time), 3))


AIMS = Aims(
    steps=[Step(1, 0.0, 0.0, 0.1), Step(3, 0.1, 0.0, -0.1, until=0.4)],
    stops=[Stop(1, 1, 0.1, 0.2), Stop(2, 1, 0.3, 0.5), Stop(1, 2, 0.6, 0.8)],
    paths=[Path(1, 0.1, 0.9, 0.3)],
)


@pytest.mark.parametrize("end", [end for end in ENDS if end != "completed"])
def test_a_failed_trial_has_the_worst_of_everything(end):
    one_row = np.zeros((1, 3))
    failed = response(np.zeros(1), one_row, one_row, end=end, why="said")
    found = measure(failed, AIMS)
    assert list(found) == expected_measures(AIMS)
    assert all(value == MEASURES[name].worst for name, value in found.items())
    assert set(measure_repeats([failed, failed], AIMS).values()) == {math.inf}


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 5.0))
def test_any_motion_has_all_its_measures_and_none_is_nan(seed, size):
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 1.0, 200)
    position = HOME + size * rng.normal(size=(200, 3)).cumsum(axis=0) * 0.02
    columns = {name: rng.normal(size=(200, 3)) for name in ("voltage", "applied", "current")}
    reference = HOME + np.outer(time, (0.3, 0.2, -0.1))
    trial = response(time, position, rng.normal(size=(200, 3)), reference, **columns)
    found = measure(trial, AIMS)
    assert list(found) == expected_measures(AIMS)
    assert all(value >= 0.0 for value in found.values())
    assert measure(trial, AIMS) == found
    repeats = measure_repeats([trial, trial], AIMS)
    assert set(repeats) == {n for n in expected_measures(AIMS, 2) if MEASURES[n].group in ("pose", "path")}
    # a path that repeats itself scatters by nothing; its places lie about their mean by nothing too
    assert repeats.get("path_repeatability", 0.0) in (0.0, math.inf) or repeats["path_repeatability"] < 1e-12


@pytest.mark.parametrize(
    "aims, changes, message",
    [
        (Aims(steps=[Step(4, 0.0, 0.0, 1.0)]), {}, "joint 4; expected 1, 2 or 3"),
        (Aims(steps=[Step(1, 3.0, 0.0, 1.0)]), {}, "no samples after 3 s"),
        (Aims(stops=[Stop(1, 1, 0.5, 3.0)]), {}, "3 s; expected a time within the response, 0 to 1 s"),
        (Aims(paths=[Path(1, 0.5, 0.501, 0.1)]), {}, "three rows at least"),
        (Aims(paths=[Path(1, 0.1, 0.9, 0.1)]), {}, "path 1 stands still"),
        (Aims(stops=[Stop(1, 1, 0.5, 0.9)]), {"arm": None}, "no arm; expected a response with the arm's kinematics"),
    ],
)
def test_aims_that_do_not_fit_are_named(aims, changes, message):
    time = np.linspace(0.0, 1.0, 101)
    still = np.zeros((101, 3))
    with pytest.raises(ParameterError, match=message):
        measure(response(time, still, still, **changes), aims)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"time": np.array([0.0, 0.0])}, "increasing"),
        ({"position": np.zeros((3, 3))}, "shape"),
        ({"velocity": np.full((2, 3), np.nan)}, "velocity is not finite"),
        ({"end": "lost"}, "end"),
    ],
)
def test_responses_that_cannot_be_are_refused(changes, message):
    values = {"time": np.array([0.0, 1.0]), "position": np.zeros((2, 3)), "velocity": np.zeros((2, 3))} | changes
    with pytest.raises(ParameterError, match=message):
        Response(
            reference=np.zeros((2, 3)),
            voltage=np.zeros((2, 3)),
            applied=np.zeros((2, 3)),
            current=np.zeros((2, 3)),
            **values,
        )
