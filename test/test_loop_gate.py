# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The gate lets honest logs through, whatever effects they hold, and names faults by channel and
row."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from blind import generate, records
from gate_support import SERVO, moves, record, waves

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.explain import Stages
from puma_sim_core.identify.result import Fault
from puma_sim_core.plant.mechanism_file import load_mechanism

pytestmark = pytest.mark.long
PUMA, PENDULUM, SLIDE = (load_mechanism(name) for name in ("puma560", "pendulum", "slide"))
#: dry friction of joints 1 to 3, about the greatest that was measured
FRICTION = tuple(parse_effect(f"coulomb_friction:joint={j},torque={t}") for j, t in ((1, 25), (2, 14), (3, 7)))
DATA = os.environ.get("PUMA_SIM_DATA")


def uneven(seed: int, rows: int = 1600) -> np.ndarray:
    """Times of rows at 190 to 260 Hz."""
    return np.cumsum(np.random.default_rng(seed).uniform(1.0 / 260.0, 1.0 / 190.0, rows))


def dry(kind: str, more: str = "") -> list:
    """An effect with twice the friction that the library lists, on each joint."""
    return [parse_effect(f"{kind}:joint={j},torque={t}{more}") for j, t in ((1, 50), (2, 28), (3, 14))]


def lagging(step: float, hertz: float):
    """A sensor with a first-order lag."""
    last = []

    def measured(_, q):
        last[:] = [q if not last else last[0] + (1.0 - np.exp(-2.0 * np.pi * hertz * step)) * (q - last[0])]
        return last[0]

    return measured


def delayed(rows: int):
    """An input that acts some rows late."""
    before = []

    def terminal(_, volts, __):
        before.append(volts)
        return before[max(0, len(before) - 1 - rows)]

    return terminal


def noisy(seed: int, size: float):
    random = np.random.default_rng(seed)
    return lambda _, q: q + size * random.standard_normal(3)


HONEST = {
    "nothing": lambda: record(1, waves(1)),
    "Coulomb, twice": lambda: record(2, moves(2), effects=dry("coulomb_friction"), dither=0.3),
    "Coulomb at a crawl": lambda: record(3, waves(3, size=0.1, low=0.03, high=0.1), effects=dry("coulomb_friction")),
    "Stribeck, uneven times": lambda: record(
        4, waves(4), times=uneven(4), gain=0.5, dither=0.3, effects=dry("stribeck_friction", ",velocity=0.1")
    ),
    "bristles, one joint moves": lambda: record(
        5, moves(5, joints=(2,), rest=2.0), effects=dry("presliding_friction", ",stiffness=3000"), step=SERVO
    ),
    "load": lambda: record(6, moves(6), effects=[parse_effect("payload:mass=5")], step=0.005, gain=0.5),
    "a stop": lambda: record(
        7, waves(7), dither=0.3, effects=[parse_effect("soft_stop:joint=2,stiffness=10000,upper=-0.7")]
    ),
    "saturation": lambda: record(8, waves(8, size=1.0), terminal=lambda t, v, i: np.clip(v, -20.0, 20.0)),
    "dead-band, held joints": lambda: record(
        9, waves(9, joints=(1,)), terminal=lambda t, v, i: v - np.clip(v, -2.0, 2.0)
    ),
    "droop, 28 ms": lambda: record(
        10, waves(10), step=0.028, gain=0.08, duration=12.0, terminal=lambda t, v, i: v * (1.0 - 0.024 * abs(i).sum())
    ),
    "delay": lambda: record(11, moves(11), terminal=delayed(3), gain=0.5),
    "delay, from clip to clip": lambda: record(11, moves(11), terminal=delayed(3), gain=2.0),
    "sensor lag": lambda: record(12, waves(12), measured=lagging(1e-3, 5.0), gain=0.3),
    "sensor noise, no steps": lambda: record(13, moves(13), quantum=np.zeros(3), measured=noisy(13, 1e-4)),
}


@pytest.mark.parametrize("name", HONEST)
def test_an_honest_log_has_no_fault(name):
    log = HONEST[name]()
    found = check(log, PUMA)
    assert not (found.faults or found.cuts or found.doubts) and [len(part) for part in found.parts] == [len(log)]


def test_a_lag_of_fast_motion_is_no_wrong_scale(tmp_path, monkeypatch):
    """8 ms on joint 3, 5 V of dither, a motion from end to end: the lag makes the voltage of the
    accelerations look like that of another joint."""
    monkeypatch.setattr(records, "VERSION", 1)
    recipe = replace(records.plan("sensor_lag", 61001, 1)[0], version=1)
    path, answer = generate.make(recipe, tmp_path)
    (effect,) = answer["effects"]
    assert effect["parameters"]["time_constant"] > 7e-3
    assert named(read_log(path)) == {}


@pytest.mark.skipif(DATA is None, reason="PUMA_SIM_DATA names no folder")
def test_measured_logs_have_no_fault():
    columns = {"time": "t_s", "voltage1": "motor_V", "position1": "q_rad", "enable": "torque_enable"}
    runs = sorted(Path(DATA, "xl330_pendulum").glob("*.csv"))
    assert len(runs) == 8
    for run in runs:
        assert named(read_log(run, columns, 1), PENDULUM) == {}
    slide = read_log(
        Path(DATA, "emps", "emps_train.csv"), {"time": "t_s", "voltage1": "vir_V", "position1": "q_meas_m"}, 1
    )
    assert named(slide, SLIDE) == {}
    assert named(read_log(runs[-1], columns, 1), SLIDE)


# -- faults of the arm --------------------------------------------------------------------------

RATES = {"1 kHz": {"step": 0.001}, "uneven": {"times": uneven(21), "gain": 0.5}}


@cache
def base(rate: str) -> Log:
    return record(21, waves(21), effects=FRICTION, dither=0.3, **RATES[rate])


def put(log: Log, channel: str, rows, change) -> Log:
    """With some rows of a channel changed."""
    if channel == "time":
        time = log.time.copy()
        time[rows] = change(time[rows])
        return replace(log, time=time)
    group, joint = channel[:-1], int(channel[-1]) - 1
    values = getattr(log, group).copy()
    values[rows, joint] = change(values[rows, joint])
    return replace(log, **{group: values}, quantum=np.zeros(0))


def dropped(log: Log, first: int, rows: int, stamped_again: bool = False) -> Log:
    stay = np.ones(len(log), dtype=bool)
    stay[first : first + rows] = False
    time = log.time[: stay.sum()] if stamped_again else log.time[stay]
    return replace(log, time=time, voltage=log.voltage[stay], position=log.position[stay])


def moving_row(log: Log, joint: int, after: float = 0.3) -> int:
    """A row in which a joint moves fast."""
    speed = np.abs(np.gradient(log.position[:, joint - 1], log.time))
    smooth = np.convolve(speed, np.ones(25) / 25.0, "same")
    first = int(after * len(log))
    return first + int(np.argmax(smooth[first : first + len(log) // 3]))


def named(log: Log, mechanism=PUMA) -> dict[str, int | None]:
    found = check(log, mechanism)
    faults = found.faults or (*found.cuts, *found.doubts)
    assert all("expected" in fault.what for fault in faults)
    # what is left beside a cut may be too short to be used
    return {fault.channel: fault.row for fault in faults if fault.row is None or "too short" not in fault.what}


@pytest.mark.parametrize("rate", RATES)
def test_faults_of_rows_are_named_with_their_row(rate):
    log = base(rate)
    assert named(log) == {}
    r, step = len(log) // 2, np.median(np.diff(log.time))
    at = slice(r, r + 1)
    fast = moving_row(log, 2)
    cases = [
        (put(log, "position2", [r, r + 7], lambda q: q * np.nan), "position2", r),
        (put(log, "voltage3", at, lambda v: v + np.inf), "voltage3", r),
        (put(log, "time", at, lambda t: log.time[r - 1]), "time", r),
        (put(log, "time", at, lambda t: t - 1.5 * step), "time", r),
        (dropped(log, r, 12), "time", r),
        (dropped(log, fast, max(8, int(0.08 / step)), stamped_again=True), "time", fast),
        (put(log, "position1", at, lambda q: q + 0.1), "position1", r),
        (put(log, "position3", slice(r, r + 3), lambda q: 0.0 * q), "position3", r),
        (put(log, "voltage1", at, lambda v: v + 60.0), "voltage1", r),
    ]
    for n, (faulty, channel, row) in enumerate(cases):
        found = named(faulty)
        assert found[channel] == row + 1, n
        assert set(found) <= {channel} or (n == 5 and set(found.values()) == {row + 1}), n
    if rate == "1 kHz":
        # the motion is followed over a few rows, and a note says so
        (part,), (note,) = check(dropped(log, r, 1), PUMA).parts, check(dropped(log, r, 1), PUMA).notes
        assert named(dropped(log, r, 1)) == {} and len(part) == len(log) - 1 and "missing or late" in note


def test_stamps_that_jump_about_are_not_the_times_of_samples():
    random = np.random.default_rng(3)
    log = base("1 kHz")
    shaken = replace(log, time=log.time + 1e-3 * random.uniform(-0.4, 0.4, len(log)))
    assert named(shaken) == {"time": None}
    rest = replace(shaken, position=np.round(log.position * 0.0 + 0.3, 4))
    assert set(named(rest)) != {"time"}


@pytest.mark.parametrize("rate", RATES)
def test_frozen_channels(rate):
    log = base(rate)
    step = np.median(np.diff(log.time))
    for joint, lasts in ((1, 0.5), (2, 0.5), (2, 1e3), (3, 1e3)):
        row = moving_row(log, joint)
        held = log.position[row - 1, joint - 1]
        found = named(put(log, f"position{joint}", slice(row, row + int(lasts / step)), lambda q: 0.0 * q + held))
        assert list(found) == [f"position{joint}"]
        assert abs(found[f"position{joint}"] - row - 1) <= 4
    whole = put(log, "position2", slice(None), lambda q: 0.0 * q - 0.9)
    assert named(whole) == {"position2": None}
    assert named(put(log, "voltage3", slice(None), lambda v: 0.0 * v + 3.0)) == {"voltage3": None}
    row = moving_row(log, 3)
    stuck = put(log, "voltage3", slice(row, row + int(1.5 / step)), lambda v: 0.0 * v + log.voltage[row - 1, 2])
    found = named(stuck)
    assert list(found) == ["voltage3"] and found["voltage3"] in (None, row + 1)


def test_channels_that_are_not_what_they_are_called():
    log = base("1 kHz")
    for joint in (1, 2, 3):
        position, voltage = f"position{joint}", f"voltage{joint}"
        other = joint % 3 + 1
        order = list(range(3))
        order[joint - 1], order[other - 1] = other - 1, joint - 1
        pair = {f"position{joint}": None, f"position{other}": None}
        volts = {f"voltage{joint}": None, f"voltage{other}": None}
        every = slice(None)
        for faulty, expected in (
            (put(log, position, every, np.negative), {position: None}),
            (put(log, voltage, every, np.negative), {voltage: None}),
            (put(log, position, every, np.degrees), {position: None}),
            (put(log, position, every, lambda q: 1.72 * q), {position: None}),
            (put(log, voltage, every, lambda v: 1e3 * v), {voltage: None}),
            (replace(log, position=log.position[:, order], quantum=np.zeros(0)), pair),
            (replace(log, voltage=log.voltage[:, order]), volts),
        ):
            assert named(faulty) == expected, (joint, expected)


def test_millivolts_of_one_joint_beside_others_that_are_explained_to_the_last():
    """The others have next to nothing left, and need not lose any of it."""
    log = record(4, waves(4), noise=0.0, theta=PUMA.start)
    for joint in (1, 2, 3):
        faulty = put(log, f"voltage{joint}", slice(None), lambda v: 1e3 * v)
        (found,) = check(faulty, PUMA).faults
        assert found.channel == f"voltage{joint}" and "millivolts" in found.what


def test_units_of_all_channels_offsets_and_other_plants():
    log = base("1 kHz")
    angles, volts = ({f"{group}{j}": None for j in (1, 2, 3)} for group in ("position", "voltage"))
    assert named(replace(log, position=np.degrees(log.position), quantum=np.zeros(0))) == angles
    assert named(replace(log, voltage=1e3 * log.voltage)) == volts
    assert named(replace(log, voltage=np.round(51.2 * log.voltage))) == volts
    assert named(replace(log, time=1e3 * log.time)) == {"time": None}
    assert named(put(log, "position2", slice(None), lambda q: q + 1.57)) == {"position2": None}
    assert named(put(log, "position1", slice(None), lambda q: q + 6.28)) == {"position1": None}
    another = replace(log, voltage=log.voltage[::-1].copy())
    assert set(named(another)) <= set(volts) and named(another)


def test_logs_that_tell_nothing_and_enable_that_is_no_switch():
    log = base("1 kHz")
    assert named(replace(dropped(log, 90, 10**6))) == {"time": None}
    assert named(dropped(log, 900, 10**6)) == {"time": None}
    still = replace(log, position=0.0 * log.position + 0.5, voltage=0.0 * log.voltage + 1.0)
    assert named(still) == {f"position{j}": None for j in (1, 2, 3)}
    on = np.ones((len(log), 3))
    on[700] = 0.5
    assert named(replace(log, enable=on)) == {"enable": 701}
    on[:, 1] = 1.0
    assert named(replace(log, enable=on)) == {"enable1": 701, "enable3": 701}


# -- machines of one joint ---------------------------------------------------------------------


def one_joint(mechanism, seed: int, amplitude: float, friction: float, step: float = 0.004) -> Log:
    """A log of one joint on its way along three sines, its volts by the inverse model with
    parameters that are wrong, dry friction and noise."""
    random = np.random.default_rng(seed)
    theta = mechanism.start + 0.7 * mechanism.deviations * random.uniform(-1, 1, len(mechanism.start))
    time = step * np.arange(int(6.0 / step))
    q, qd, qdd = np.zeros((3, len(time), 1))
    for f, phase in zip(random.uniform(0.2, 1.2, 3), random.uniform(0.0, 6.0, 3)):
        turn = 2.0 * np.pi * f
        q[:, 0] += amplitude * np.sin(turn * time + phase)
        qd[:, 0] += amplitude * turn * np.cos(turn * time + phase)
        qdd[:, 0] -= amplitude * turn**2 * np.sin(turn * time + phase)
    k = mechanism.drive(theta).volts_per_torque
    volts = mechanism.model_voltage(theta, q, qd, qdd) + k * mechanism.torque_scale * friction * np.tanh(
        50.0 * qd / np.abs(qd).max()
    )
    volts += 0.02 * volts.std() * random.standard_normal(volts.shape)
    quantum = 2e-4 * amplitude
    return Log("one", time, volts, np.round(q / quantum) * quantum)


@pytest.mark.parametrize("mechanism, amplitude", [(PENDULUM, 0.4), (SLIDE, 0.04)], ids=["pendulum", "slide"])
def test_machines_of_one_joint(mechanism, amplitude):
    for friction in (0.0, 2.0):
        log = one_joint(mechanism, 5, amplitude, friction)
        assert named(log, mechanism) == {}
        row = moving_row(log, 1)
        everywhere = slice(None)
        assert named(put(log, "position1", everywhere, np.negative), mechanism) == {"position1": None}
        assert named(put(log, "voltage1", everywhere, np.negative), mechanism) == {"position1": None}  # the same
        thousand = put(log, "position1", everywhere, lambda q: 1e3 * q)
        assert named(thousand, mechanism) == {"position1": None}
        assert named(put(log, "position1", [row], lambda q: q + 0.3 * amplitude), mechanism) == {"position1": row + 1}
        found = named(
            put(log, "position1", slice(row, row + 120), lambda q: 0.0 * q + log.position[row - 1, 0]), mechanism
        )
        assert list(found) == ["position1"] and abs(found["position1"] - row - 1) <= 4
        mixed = replace(log, voltage=log.voltage[::-1].copy())
        assert named(mixed, mechanism)
    if mechanism is PENDULUM:
        degrees = put(log, "position1", slice(None), np.degrees)
        assert named(degrees, mechanism) == {"position1": None}


@pytest.mark.parametrize("left, lifted", [(0.03, True), (30.0, False)])
def test_a_doubt_about_a_voltage_that_stays_at_its_limit_is_lifted_by_a_model_that_explains_it(left, lifted):
    """Its changes say nothing of its size: there are none."""
    rows, doubt = np.ones((50, 1), dtype=bool), Fault.of("voltage1", None, "unexplained", "a log of the machine")
    stretch = SimpleNamespace(voltage=np.full((51, 1), 40.0))
    predictor = SimpleNamespace(stretches=[stretch], fit_rows=rows, friction_volts=np.array([0.7]))
    stages = SimpleNamespace(predictor=predictor, _volts=lambda point: np.full((50, 1), left))
    state = SimpleNamespace(chosen=("a limit",), model=SimpleNamespace(point=None))
    assert Stages.unexplained(stages, state, [doubt]) == ([] if lifted else [doubt])
