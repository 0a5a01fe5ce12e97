# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A second position sensor on the link's side: what is read, compared, named and written."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from cli_support import puma_sim
from linkage_support import known, linkage, torque_drive
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from puma_sim_core.checks import Reader
from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.files import yaml_text
from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.machine_log import read_for
from puma_sim_core.identify.link_side.compare import compare
from puma_sim_core.identify.link_side.evidence import NoiseGrid
from puma_sim_core.identify.link_side.sides import sides
from puma_sim_core.identify.report.html import page
from puma_sim_core.identify.report.json import report_text
from puma_sim_core.identify.settings import NOISE
from puma_sim_core.plant.linkage.linkage_file import linkage_mapping, read_linkage
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.transmission import read_transmission
from puma_sim_core.resources import config_path

GAIN, INERTIA = 100.0, 20.0
STEP, STEPS = 1e-5, 4e-3


def quantity(value, unit, **more):
    return {"value": value, "unit": unit, **more}


def joint(**changes):
    """The entry of a joint: a gear of 100, a friction of 50 N.m."""
    drive = {
        "amplifier": "torque",
        "gain": known(GAIN, "1"),
        "motor_inertia": known(INERTIA, "kg.m^2"),
        "viscous_friction": known(0.0, "N.m.s/rad"),
    }
    own = {
        "range": quantity([-3.0, 3.0], "rad"),
        "torque_scale": quantity(50.0, "N.m"),
        "drive": drive,
        "link_sensor": {"resolution": quantity(STEP, "rad")},
    }
    return {key: value for key, value in {**own, **changes}.items() if value is not None}


def file_of(*joints):
    own = {f"joint{n}": entry for n, entry in enumerate(joints, 1)}
    return {"format": MECHANISM_FORMAT, "name": "gears", "kind": "transmission", **own}


def transmission(count=1):
    return read_transmission(file_of(*[joint()] * count), Reader(None))


def motion(time, seed=0):
    """Position, speed and acceleration of a sum of sines up to 1.5 Hz."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.1, 1.5, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    w, size = 2.0 * np.pi * f, 0.15 / (0.3 + f)
    angle = w * time[:, None] + phase
    return (size * np.sin(angle)).sum(1), (size * w * np.cos(angle)).sum(1), -(size * w**2 * np.sin(angle)).sum(1)


def through(time, own):
    """The torque between motor and link: weight, friction and inertia."""
    q, qd, qdd = motion(time, own)
    return 300.0 * np.sin(q + 0.4) + 40.0 * np.tanh(qd / 0.01) + 60.0 * qdd


def made(late=0.0, stiffness=np.inf, gap=0.0, lag=0.0, noise=2e-5, seconds=12.0, seed=0, own=0):
    """A log of one joint with both sensors and noise that lasts 0.1 s."""
    rng = np.random.default_rng(1000 + seed)
    time = STEPS * np.arange(round(seconds / STEPS))
    q, _, _ = motion(time, own)
    torque = through(time, own)
    link, _, _ = motion(time - late, own)
    link = link - torque / stiffness - 0.5 * gap * np.sign(torque) + 0.7
    if lag:
        slow, decay = np.empty_like(link), np.exp(-STEPS / lag)
        slow[0] = link[0]
        for r in range(1, len(link)):
            slow[r] = decay * slow[r - 1] + (1.0 - decay) * 0.5 * (link[r] + link[r - 1])
        link = slow
    decay = np.exp(-STEPS / 0.1)
    steps, drift = rng.standard_normal(len(time)), np.zeros(len(time))
    for r in range(1, len(time)):
        drift[r] = decay * drift[r - 1] + np.sqrt(1.0 - decay**2) * steps[r]
    rounded = [STEP * np.round(values / STEP) for values in (q, link + noise * drift)]
    # a row's torque is that until the next row, and so of the middle between them
    middle = time + 0.5 * STEPS
    motor = (through(middle, own) + INERTIA * motion(middle, own)[2]) / GAIN
    return Log("made", time, motor[:, None], rounded[0][:, None], link_position=rounded[1][:, None])


def joined(*logs):
    """Logs of one joint each as one log of several."""
    columns = {n: np.hstack([getattr(log, n) for log in logs]) for n in ("voltage", "position", "link_position")}
    return Log("joined", logs[0].time, **columns)


def names(side):
    return [effect.name for effect in side.effects]


# ------------------------------------------------------------------------------------------- mathematics


def test_a_filter_makes_a_series_late():
    time = 0.01 * np.arange(600)
    wave = np.column_stack([np.sin(3.0 * time) + 0.3 * time, np.cos(7.0 * time)])
    late = np.column_stack([np.sin(3.0 * (time - 0.013)) + 0.3 * (time - 0.013), np.cos(7.0 * (time - 0.013))])
    found, rate = filters.low_pass(wave, 0.01, 12.0, (0, 1), delay=0.013)
    inner = slice(60, -60)
    assert_allclose(found[inner], late[inner], atol=1e-6)
    assert_allclose(rate[inner], np.gradient(late, 0.01, axis=0)[inner], atol=2e-2)


def test_evidence_is_the_sum_of_normal_densities_over_all_noises():
    both = sides([made(seconds=3.0)], transmission())
    grid = NoiseGrid(both)
    rng = np.random.default_rng(3)
    m = len(both.time)
    X, prior = rng.standard_normal((m, 2)), np.array([0.3, 2.0])
    y = X @ [0.2, -1.0] + 0.05 * rng.standard_normal(m)
    deviations = np.array([0.02, 0.05, 0.1])
    (found,) = grid.posteriors(y[:, None], X, prior, deviations)
    place, logs = np.arange(m), []
    for covariance in grid.covariances:
        C = covariance[np.abs(place[:, None] - place)] + NOISE.residual_jitter * covariance[0] * np.eye(m)
        for deviation in deviations:
            whole = deviation**2 * C + (X * prior**2) @ X.T
            logs.append(multivariate_normal(np.zeros(m), whole).logpdf(y))
    assert_allclose(found.log_evidence, logsumexp(logs) - np.log(len(logs)), rtol=1e-8)
    assert np.all(np.abs(found.mean - [0.2, -1.0]) < 4.0 * np.sqrt(np.diag(found.covariance)))


# ------------------------------------------------------------------------------------------- what is named


@pytest.mark.parametrize("late", [0.003, pytest.param(-0.002, marks=pytest.mark.long)])
def test_a_reading_that_is_late_is_named_with_its_sensor(late):
    (side,) = compare([made(late=late)], transmission(), 0)
    assert names(side) == ["sensor_lag"]
    (effect,) = side.effects
    size = effect.parameters["time_constant"]
    assert effect.sensor == ("link" if late > 0.0 else "motor")
    assert size.low <= abs(late) <= size.high and size.high - size.low < 5e-4 and size.unit == "s"
    assert side.held_out_after < 0.1 * side.held_out_before


@pytest.mark.long
def test_a_lag_of_first_order_is_told_from_a_delay_where_it_bends():
    (side,) = compare([made(lag=0.03, noise=2e-6)], transmission(), 0)
    (effect,) = side.effects
    assert (effect.name, effect.sensor, effect.law, effect.either_law) == ("sensor_lag", "link", "lag", False)
    assert_allclose(effect.parameters["time_constant"].value, 0.03, rtol=0.02)
    (side,) = compare([made(late=0.03, noise=2e-6)], transmission(), 0)
    assert (side.effects[0].law, side.effects[0].either_law) == ("delay", False)


def test_a_twist_beside_a_late_reading_is_named_second():
    (side,) = compare([made(late=0.003, stiffness=1e6)], transmission(), 0)
    assert names(side) == ["sensor_lag", "joint_elasticity"]
    stiffness = side.effects[1].parameters["stiffness"]
    assert_allclose(stiffness.value, 1e6, rtol=0.03)
    assert stiffness.high - stiffness.low < 5e4 and stiffness.unit == "N.m/rad"


def test_a_twist_alone_is_no_late_reading():
    (side,) = compare([made(stiffness=1e6)], transmission(), 0)
    assert names(side) == ["joint_elasticity"]


def test_backlash_shows_where_the_torque_changes_its_sign():
    (side,) = compare([made(gap=1e-3)], transmission(), 0)
    assert names(side) == ["backlash"]
    gap = side.effects[0].parameters["gap"]
    assert gap.low <= 1e-3 <= gap.high


def test_a_twist_against_the_torque_has_no_name():
    (side,) = compare([made(stiffness=-1e6)], transmission(), 0)
    assert not {"joint_elasticity", "backlash"} & set(names(side))


def test_without_a_torque_only_late_readings_can_be_asked_for():
    mapping = file_of(joint(drive={"amplifier": "none"}))
    (side,) = compare([made(late=0.003, stiffness=1e6)], read_transmission(mapping, Reader(None)), 0)
    assert names(side) == ["sensor_lag"]


@pytest.mark.long
def test_noise_alone_gets_no_name():
    """Thirty joints whose readings differ by noise that lasts, as the torque does."""
    for seed in range(10):
        logs = [made(noise=10.0 ** (-5.5 + 0.7 * n), seed=10 * seed + n, own=10 * seed + n) for n in range(3)]
        for side in compare([joined(*logs)], transmission(3), 0):
            assert names(side) == [], (seed, side)


@pytest.mark.thorough
def test_intervals_hold_the_true_sizes():
    """Of 60 intervals of 95 % six at most fail with a probability of 0.97; eight and more are wrong intervals."""
    missed = 0
    for seed in range(20):
        logs = [made(late=0.004, noise=3e-5, seed=10 * seed + n, own=10 * seed + n) for n in range(3)]
        for side in compare([joined(*logs)], transmission(3), 0):
            assert names(side)[0] == "sensor_lag"
            size = side.effects[0].parameters["time_constant"]
            missed += not size.low <= 0.004 <= size.high
    assert missed <= 7


def test_zeros_are_arbitrary_and_the_two_directions_alike():
    log = made(late=0.003, stiffness=1e6)
    sizes = []
    turned = replace(log, voltage=-log.voltage, position=-log.position, link_position=-log.link_position)
    for each in (
        log,
        replace(log, link_position=log.link_position - 2.0),
        turned,
        replace(log, time=log.time + 1000.0),
    ):
        (side,) = compare([each], transmission(), 0)
        assert names(side) == ["sensor_lag", "joint_elasticity"]
        sizes.append([next(iter(effect.parameters.values())).value for effect in side.effects])
    assert_allclose(sizes, [sizes[0]] * 4, rtol=1e-5)


def test_several_logs_with_a_zero_each():
    one, two = made(late=0.003, seed=1), made(late=0.003, seed=2, own=5)
    (side,) = compare([one, replace(two, link_position=two.link_position + 1.3)], transmission(), 0)
    assert names(side) == ["sensor_lag"] and side.held_out_after < 1e-4
    assert compare([one], transmission(), 0) == compare([one], transmission(), 0)


# ------------------------------------------------------------------------------------------- files and reports


def written(path, log, **changes):
    columns = {"time": log.time}
    for j in range(log.position.shape[1]):
        columns |= {f"{g}{j + 1}": getattr(log, g)[:, j] for g in ("voltage", "position", "link_position")}
    columns |= changes
    rows = zip(*columns.values())
    path.write_text(",".join(columns) + "\n" + "\n".join(",".join(map(repr, map(float, row))) for row in rows) + "\n")
    return path


@pytest.fixture
def plant(tmp_path):
    path = tmp_path / "gears.yaml"
    path.write_text(yaml_text(file_of(joint(), joint(drive={"amplifier": "none"}))))
    return path


@pytest.fixture
def log_file(tmp_path):
    return written(tmp_path / "two.csv", joined(made(late=0.003, stiffness=1e6), made(seed=4, own=4)))


def test_a_report_on_transmissions(plant, log_file):
    found = explain(log_file, plant=str(plant))
    assert found.verdict == "NAMED"
    assert [(e.name, e.joint) for e in found.effects] == [("sensor_lag", 1), ("joint_elasticity", 1)]
    assert (
        re.search("On joint 1 the link's reading is late by (3|2.9).* ms", found.sentence)
        and "On joint 2" in found.sentence
    )
    report = json.loads(report_text(found))
    schema = json.loads(config_path("explain_report.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(schema).validate(report)
    assert [side["joint"] for side in report["link_side"]] == [1, 2]
    assert report["errors"]["fit"] is None and found.model is None
    text = page(found)
    assert 'id="link_side"' in text and "Error " in text and not re.search(r"\bnan\b", text)
    again = explain(log_file, plant=str(plant))
    assert report_text(replace(again, seconds=0.0)) == report_text(replace(found, seconds=0.0))


def test_readings_that_agree_miss_nothing(tmp_path, plant):
    log = written(tmp_path / "same.csv", joined(made(noise=1e-6), made(noise=1e-6, own=3)))
    found = explain(log, plant=str(plant))
    assert found.verdict == "NOTHING_MISSING" and "steps of the two sensors" in found.sentence
    noisy = written(tmp_path / "noisy.csv", joined(made(noise=1e-3), made(noise=1e-3, own=3)))
    assert explain(noisy, plant=str(plant)).verdict == "UNNAMED"


def test_a_linkage_with_a_link_sensor_gets_both_answers(tmp_path):
    sensor = {"link_sensor": {"resolution": quantity(STEP, "rad")}}
    body = linkage(shoulder=torque_drive())
    mapping = linkage_mapping(body)
    mapping["shoulder"] |= sensor
    again = read_linkage(mapping)
    assert again.moving[0].link_sensor.resolution == STEP
    assert read_linkage(linkage_mapping(again)) == again
    path = tmp_path / "arm.yaml"
    path.write_text(yaml_text(mapping))
    mechanism = load_mechanism(path)
    assert mechanism.link_sensors[0].resolution == STEP and mechanism.links_known


def test_a_link_position_is_read_by_its_unit_and_its_joint(tmp_path, plant):
    log = made()
    degrees = np.degrees(log.link_position[:, 0])
    plain = joined(log, log)
    path = written(tmp_path / "deg.csv", replace(plain, link_position=plain.link_position), link_position1_deg=degrees)
    columns = {"link_position1": "link_position1_deg"}
    found = read_for(load_mechanism(plant), path, columns)
    assert_allclose(found.link_position, plain.link_position, atol=1e-12)
    pendulum = written(tmp_path / "one.csv", log)
    assert read_for(load_mechanism("pendulum"), pendulum).link_position is not None
    text = pendulum.read_text().replace("link_position1", "other")
    (tmp_path / "none.csv").write_text(text)
    with pytest.raises(RecordingError, match="channel 'voltage2' is missing|'link_position1' is missing"):
        read_for(transmission(), tmp_path / "none.csv")


def test_rows_without_a_link_position_are_left_out(plant):
    log = made(late=0.003)
    link = log.link_position.copy()
    link[1500:1510] = np.nan
    checked = check(replace(log, link_position=link), transmission())
    assert [len(part) for part in checked.parts] == [1500, len(log) - 1510] and not checked.faults
    assert checked.cuts[0].channel == "link_position1"
    (side,) = compare(checked.parts, transmission(), 0)
    assert names(side) == ["sensor_lag"]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda m: m.pop("joint1"), "joint1: missing; expected joints in order"),
        (lambda m: m["joint1"].pop("link_sensor"), "joint1.link_sensor: missing"),
        (lambda m: m["joint1"]["link_sensor"].update(step=1), "joint1.link_sensor.step: unknown key"),
        (lambda m: m["joint1"]["link_sensor"]["resolution"].update(value=-1.0), "joint1.link_sensor.resolution.value"),
        (lambda m: m["joint1"]["link_sensor"]["resolution"].update(unit="deg"), "resolution.unit: unit 'deg'"),
        (lambda m: m["joint1"]["drive"].update(amplifier="voltage"), "joint1.drive.amplifier: voltage"),
        (
            lambda m: m["joint1"]["drive"].update(gain=quantity(1.0, "1", deviation=0.1)),
            "joint1.drive.gain: a prior; expected known: true",
        ),
        (lambda m: m.update(joint4=joint()), "joint3: missing; expected joints in order"),
        (lambda m: m.update(elbow=joint()), "elbow: unknown key"),
    ],
)
def test_files_that_cannot_be_used(change, match):
    mapping = file_of(joint(), joint())
    change(mapping)
    with pytest.raises(ParameterError, match=match):
        read_transmission(mapping, Reader(None))


@pytest.mark.long
def test_what_needs_the_links_is_refused(log_file, tmp_path):
    plant = tmp_path / "driven.yaml"
    plant.write_text(yaml_text(file_of(joint(), joint())))
    for command in (
        ["excite", "--plant", plant, "--separate", "coulomb_friction@1", "--out", tmp_path / "x.csv"],
        ["view", log_file, "--plant", plant, "--export", tmp_path / "x.html"],
    ):
        found = puma_sim(*map(str, command))
        assert found.returncode == 2 and "whose links are not described" in found.stderr, found.stderr
    found = puma_sim("explain", str(log_file), "--plant", str(plant), "--dry-run")
    assert found.returncode == 0 and "can show: sensor_lag, joint_elasticity, backlash" in found.stdout
