# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The columns by which effects are looked for, against the simulated arm that has the effect.

Torques are compared through the recorded motor current: N kt i, less what the model without the
effect needs for the motion, is what the effect takes, to the rounding of the numbers. Voltages
are compared through the screening's kind of filter.
"""

from __future__ import annotations

import numpy as np
import pytest
from screening_support import ARM, STEP, recorded, residual, signals_of, smoothed, torque_per_ampere, volts

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.effects.impulse import impulse
from puma_sim_core.effects.screening import TORQUE_COLUMN, Illegal

pytestmark = pytest.mark.long


def at(name, joint, grid):
    """Joint as the screening counts it, and the choice of the candidate nearest to `grid`."""

    def choose(signals):
        found = KINDS[name].screening.candidates(signals, joint)
        assert found, f"no candidates of {name}"
        return min(found, key=lambda c: sum(abs(np.log(c.grid[k] / v)) for k, v in grid.items()))

    return choose


def effect_of(name, joint, values):
    return str(Effect(KINDS[name], None if joint is None else joint + 1, values))


def as_signals(run, **fields):
    return signals_of(run.time, run.voltage, run.position, run.velocity, run.acceleration, **fields)


@pytest.fixture(scope="module")
def plain():
    """Signals of the arm without effects."""
    return as_signals(recorded())


# -------------------------------------------------------------------- torques, to the last digits


TORQUES = [
    ("coulomb_friction", 0, [8.0], {}),
    ("asymmetric_coulomb_friction", 1, [9.0, 5.0], {}),
    ("stribeck_friction", 2, [3.0, 2.0], {"velocity": 0.05}),
    ("load_dependent_friction", 1, [0.12], {}),
    ("position_dependent_friction", 2, [4.0, 0.8, -0.6], {}),
    ("quadratic_friction", 0, [6.0], {}),
    ("friction_warm_up", 1, [0.4], {"time_constant": 3.0}),
    ("torque_ripple", 0, [1.5, -1.0], {"order": 2.0}),
    ("torque_ripple", 2, [0.5, 0.7], {"order": 6.0}),
    ("joint_spring", 1, [8.0, 3.0], {}),
    # the second column is exact where it was made, 0.1 m beside the forearm: inertia grows with the square
    ("payload", None, [1.2, 0.12], {"z": 0.4318}),
]


@pytest.mark.parametrize(
    "name, joint, coefficients, grid", TORQUES, ids=[f"{c[0]}{'' if c[1] is None else c[1] + 1}" for c in TORQUES]
)
def test_column_is_the_torque_that_the_effect_takes(plain, name, joint, coefficients, grid):
    choose = at(name, joint, grid)
    values = choose(plain).values(np.array(coefficients))
    run = recorded(effect_of(name, joint, values))
    signals = as_signals(run)
    candidate = choose(signals)
    assert candidate.unit == TORQUE_COLUMN
    # the mean of the position, about which a spring is written, is another in this run
    again = fitted(signals, run, candidate)
    assert candidate.values(again) == pytest.approx(values, rel=2e-3, abs=1e-4)
    taken = run.current * torque_per_ampere() - signals.torque
    expected = torque(signals, candidate, again)
    sliding = np.abs(signals.velocity) > 0.01
    assert np.abs(taken - expected)[sliding].max() < 2e-3 * np.abs(expected).max()


def torque(signals, candidate, coefficients):
    out = np.zeros_like(signals.position)
    for column, c in zip(candidate.columns, coefficients):
        for j, values in column.items():
            out[:, j] += c * values
    return out


def fitted(signals, run, candidate):
    """Least squares of the candidate's columns on the torque that is missing, sliding rows."""
    missing = run.current * torque_per_ampere() - signals.torque
    sliding = np.abs(signals.velocity) > 0.01
    rows = np.stack([torque(signals, candidate, unit)[sliding] for unit in np.eye(len(candidate.columns))], axis=1)
    return np.linalg.lstsq(rows, missing[sliding], rcond=None)[0]


# ---------------------------------------------------------------- a bristle, a stop, a lean, a blow


def test_column_of_a_bristle_is_its_deflection(plain):
    choose = at("presliding_friction", 0, {"yield_deflection": 5e-4})
    values = choose(plain).values(np.array([9.0]))
    assert values["torque"] == 9.0
    run = recorded(effect_of("presliding_friction", 0, values))
    signals = as_signals(run)
    taken = (run.current * torque_per_ampere() - signals.torque)[:, 0]
    column = choose(signals).columns[0][0]
    # both step the same law; the samples of the log are those of the model
    assert np.abs(taken - 9.0 * column)[50:].max() < 0.02 * 9.0
    assert np.abs(column).max() <= 1.0


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_column_of_a_stop_begins_at_its_place(plain, end):
    q = plain.position[:, 2]
    place = np.quantile(q, 0.93 if end == "upper" else 0.07)
    values = {"lower": -10.0, "upper": 10.0, "stiffness": 300.0, "damping": 0.0, end: place}
    run = recorded(effect_of("soft_stop", 2, values))
    signals = as_signals(run)
    taken = (run.current * torque_per_ampere() - signals.torque)[:, 2]
    found = [c for c in KINDS["soft_stop"].screening.candidates(signals, 2) if end in c.grid]
    candidate = min(found, key=lambda c: abs(c.grid[end] - place))
    column = candidate.columns[0][2]
    stiffness = float(column @ taken / (column @ column))
    again = candidate.values(np.array([stiffness]))
    assert again[end] == candidate.grid[end] and again["stiffness"] == stiffness
    assert Effect(KINDS["soft_stop"], 3, again).on(ARM.arm).values[end] == again[end]
    assert np.linalg.norm(taken - stiffness * column) < 0.15 * np.linalg.norm(taken)
    assert stiffness == pytest.approx(300.0, rel=0.25)


def test_columns_of_a_lean_are_linear_in_it():
    run = recorded("base_tilt:x=0.01,y=-0.006")
    signals = as_signals(run)
    (candidate,) = KINDS["base_tilt"].screening.candidates(signals, None)
    taken = run.current * torque_per_ampere() - signals.torque
    expected = torque(signals, candidate, [0.01, -0.006])
    assert candidate.values(np.array([0.01, -0.006])) == {"x": 0.01, "y": -0.006}
    assert np.abs(taken - expected).max() < 0.02 * np.abs(expected).max()
    assert np.abs(expected[:, 0]).max() > 0.1


def test_a_blow_is_found_where_it_came(plain):
    run = recorded("impulse:joint=2,torque=-70,time=1.7234,width=0.065")
    signals = as_signals(run)
    missing = residual(signals)
    assert impulse(signals, 1) == []
    found = impulse(signals, 1, missing)
    best = min((c for c in found if c.grid["width"] == 0.065), key=lambda c: abs(c.grid["time"] - 1.7234))
    assert abs(best.grid["time"] - 1.7234) < 3.0 * STEP
    assert best.tried > 50
    values = best.values(np.array([-70.0]))
    assert values == {"torque": -70.0, "time": best.grid["time"], "width": 0.065}
    error = smoothed(missing - volts(signals, best, [-70.0]), signals)
    assert np.abs(error).max() < 0.1 * np.abs(smoothed(missing, signals)).max()


# ------------------------------------------------------------------------------------- voltages


VOLTAGES = [
    ("voltage_offset", 1, [0.3], {}, 0.02),
    ("resistance_drift", 2, [0.3], {"time_constant": 3.0}, 0.02),
    ("supply_droop", None, [0.006], {}, 0.03),
    ("input_delay", None, [0.002], {"time": 0.002}, 0.02),
    ("voltage_dead_band", 2, [1.0, 0.05], {"voltage": 0.5}, 0.02),
]


@pytest.mark.parametrize("name, joint, coefficients, grid, tolerance", VOLTAGES, ids=[c[0] for c in VOLTAGES])
def test_column_is_the_voltage_that_is_missing(plain, name, joint, coefficients, grid, tolerance):
    choose = at(name, joint, grid)
    values = choose(plain).values(np.array(coefficients))
    signals = as_signals(recorded(effect_of(name, joint, values)))
    candidate = choose(signals)
    assert candidate.values(np.array(coefficients)) == pytest.approx(values)
    assert_close(residual(signals), volts(signals, candidate, coefficients), signals, tolerance)


def assert_close(missing, expected, signals, tolerance, start=0.05):
    """Both through the screening's filter, without the ends, agree within a share of the size."""
    inside = slice(int(start / STEP), -200)
    missing, expected = (smoothed(values, signals)[inside] for values in (missing, expected))
    size = np.sqrt((expected**2).mean(axis=0)).max()
    error = np.sqrt(((missing - expected) ** 2).mean(axis=0)).max()
    assert error < tolerance * size, f"{error / size:.3g} of {size:.3g} V"


@pytest.mark.parametrize(
    "name, joint, effect, parameter, true",
    [
        ("voltage_saturation", 1, "voltage_saturation:joint=2,voltage=19", "voltage", 19.0),
        ("current_limit", 2, "current_limit:joint=3,current=2", "current", 2.0),
    ],
)
def test_a_limit_is_found_by_two_columns(name, joint, effect, parameter, true):
    signals = as_signals(recorded(effect))
    missing = residual(signals)
    found = KINDS[name].screening.candidates(signals, joint)
    results = []
    for candidate in found:
        assert candidate.fixed and candidate.mean[0] == 1.0
        columns = [smoothed(volts(signals, candidate, unit), signals)[100:-100, joint] for unit in np.eye(2)]
        target = smoothed(missing, signals)[100:-100, joint]
        c = np.linalg.lstsq(np.stack(columns, axis=1), target, rcond=None)[0]
        error = target - np.stack(columns, axis=1) @ c
        results.append((float(error @ error) / float(target @ target), c, candidate))
    share, c, candidate = min(results, key=lambda r: r[0])
    assert share < 0.02
    assert c[0] == pytest.approx(1.0, abs=0.1)
    assert candidate.values(c)[parameter] == pytest.approx(true, rel=0.05)


def test_a_delay_is_a_delay_of_the_sensor_to_first_order(plain):
    """The tie that is always reported: what a lag of all sensors and a delay do looks alike."""
    (delay,) = (c for c in KINDS["input_delay"].screening.candidates(plain, None) if c.grid["time"] == 0.001)
    expected = smoothed(volts(plain, delay, [1.0]), plain, 6.0)[300:-300]
    for joint in range(3):
        (lag,) = KINDS["sensor_lag"].screening.candidates(plain, joint)
        column = smoothed(volts(plain, lag, [1.0]), plain, 6.0)[300:-300, joint]
        cosine = column @ expected[:, joint] / (np.linalg.norm(column) * np.linalg.norm(expected[:, joint]))
        assert cosine > 0.9


# ---------------------------------------------------------------------------------------- sensing


def sensed(run, joint, position, velocity, acceleration, **fields):
    """Signals of a run of which one joint's motion is measured as given."""
    motion = [values.copy() for values in (run.position, run.velocity, run.acceleration)]
    for values, measured in zip(motion, (position, velocity, acceleration)):
        values[:, joint] = measured
    return signals_of(run.time, run.voltage, *motion, **fields)


@pytest.mark.parametrize("joint", [1, 2])
def test_columns_of_an_encoder_offset(joint):
    run = recorded()
    signals = sensed(run, joint, run.position[:, joint] + 0.04, run.velocity[:, joint], run.acceleration[:, joint])
    (candidate,) = KINDS["encoder_offset"].screening.candidates(signals, joint)
    assert candidate.values(np.array([0.04])) == {"angle": 0.04}
    assert_close(residual(signals), volts(signals, candidate, [0.04]), signals, 0.06)


def test_joint_1_shows_no_offset_of_its_encoder(plain):
    assert KINDS["encoder_offset"].screening.candidates(plain, 0) == []


def test_columns_of_a_sensor_that_is_not_straight(plain):
    joint = 1
    choose = at("sensor_nonlinearity", joint, {"period": 0.9})
    values = choose(plain).values(np.array([0.0012, -0.0009]))
    run = recorded()
    q, qd, qdd = (v[:, joint] for v in (run.position, run.velocity, run.acceleration))
    w = 2.0 * np.pi / values["period"]
    angle = w * q + values["phase"]
    a = values["amplitude"]
    assert a == pytest.approx(0.0015)
    signals = sensed(
        run,
        joint,
        q + a * np.sin(angle),
        qd * (1.0 + a * w * np.cos(angle)),
        qdd * (1.0 + a * w * np.cos(angle)) - a * w * w * qd**2 * np.sin(angle),
    )
    assert_close(residual(signals), volts(signals, choose(signals), [0.0012, -0.0009]), signals, 0.05)


def test_column_of_a_lagging_sensor():
    joint, T = 2, 0.008
    run = recorded()
    motion = [lagged(v[:, joint], T) for v in (run.position, run.velocity, run.acceleration)]
    signals = sensed(run, joint, *motion)
    (candidate,) = KINDS["sensor_lag"].screening.candidates(signals, joint)
    assert candidate.values(np.array([T])) == {"time_constant": T}
    assert_close(residual(signals), volts(signals, candidate, [T]), signals, 0.05)


def lagged(values, T):
    """T m' + m = values, exact for values that change linearly between samples."""
    kept = np.exp(-STEP / T)
    out = values.copy()
    for i in range(1, len(values)):
        slope = (values[i] - values[i - 1]) / STEP
        out[i] = (values[i] - T * slope) + kept * (out[i - 1] - (values[i - 1] - T * slope))
    return out


# ----------------------------------------------------------------------------------- transmission


def test_columns_of_a_gear_that_is_not_round(plain):
    joint = 0
    choose = at("transmission_error", joint, {"order": 13.0})
    values = choose(plain).values(np.array([3e-4, 4e-4]))
    assert values["amplitude"] == pytest.approx(5e-4)
    signals = as_signals(recorded(effect_of("transmission_error", joint, values)))
    assert_close(residual(signals), volts(signals, choose(signals), [3e-4, 4e-4]), signals, 0.08)


@pytest.mark.parametrize("joint, stiffness", [(0, 2e4), (2, 5e3)])
def test_column_of_an_elastic_drive(plain, joint, stiffness):
    choose = at("joint_elasticity", joint, {"stiffness": stiffness, "damping": 10.0})
    values = choose(plain).values(np.ones(1))
    signals = as_signals(recorded(effect_of("joint_elasticity", joint, values)))
    # the grid is one of frequencies, and the mean inertia of this run is a little another
    candidate = choose(signals)
    assert candidate.fixed
    # the log begins in motion, of which the twist at the beginning is not known
    assert_close(residual(signals), volts(signals, candidate, [1.0]), signals, 0.1, start=1.5)


def test_column_of_a_drive_with_play(plain):
    joint = 0
    choose = at("backlash", joint, {"gap": 1e-3})
    values = choose(plain).values(np.ones(1))
    signals = as_signals(recorded(effect_of("backlash", joint, values)))
    assert_close(residual(signals), volts(signals, choose(signals), [1.0]), signals, 0.25, start=0.5)


@pytest.mark.parametrize("level, legal", [(3.0, True), (-0.3, True), (-0.5, False)])
def test_a_bump_may_take_a_little_of_the_level_below_it(plain, level, legal):
    values = at("stribeck_friction", 2, {"velocity": 0.05})(plain).values
    if legal:
        assert values(np.array([level, 2.0]))["sliding"] == max(level, 0.0)
        assert values(np.array([level, 2.0]))["torque"] == 2.0
    else:
        with pytest.raises(Illegal, match="negative sliding level"):
            values(np.array([level, 2.0]))
