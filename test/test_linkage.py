# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Linkages: parts of the arm against derivations of their own."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from linkage_support import LEVEL_DOWN, LEVEL_UP, PointMasses, linkage, mechanism, passive, plant, torque_drive
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from puma_sim_core.checks import Reader
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.linkage.linkage_file import check_bodies, linkage_mapping, read_linkage
from puma_sim_core.plant.linkage.linkage_mechanism import LinkageMechanism
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.model_file import dump_model, load_model
from puma_sim_core.simulation.simulator import Simulator

DRIVE = torque_drive()
PARTS = {
    "pendulum": {"shoulder": DRIVE, "zero": {"shoulder": 0.4}},
    "double pendulum": {"shoulder": DRIVE, "elbow": DRIVE},
    "double pendulum with zeros": {"shoulder": DRIVE, "elbow": DRIVE, "zero": {"shoulder": 2.1, "elbow": -0.7}},
    "rotary pendulum": {"base": DRIVE, "shoulder": passive()},
    "rotary pendulum, upright at 0": {"base": DRIVE, "shoulder": passive(), "zero": {"shoulder": pi}},
    "rotary pendulum, at an odd angle": {"base": DRIVE, "shoulder": passive(), "zero": {"shoulder": -0.9}},
    "base on a held arm": {"base": DRIVE, "shoulder": 0.3, "elbow": -0.8},
    "rotary pendulum on a held arm": {"base": DRIVE, "shoulder": 1.2, "elbow": passive(), "zero": {"elbow": 0.5}},
    "elbow on a held shoulder": {"shoulder": 0.9, "elbow": DRIVE, "zero": {"shoulder": 0.2, "elbow": 0.1}},
    "shoulder with a held elbow": {"shoulder": DRIVE, "elbow": -1.1, "zero": {"shoulder": 0.2, "elbow": 0.1}},
    "base and shoulder, elbow held": {"base": DRIVE, "shoulder": DRIVE, "elbow": 0.6, "zero": {"shoulder": LEVEL_UP}},
    "whole arm, level and down": {"base": DRIVE, "shoulder": DRIVE, "elbow": DRIVE, "zero": {"shoulder": LEVEL_DOWN}},
    "whole arm, level and up": {
        "base": DRIVE,
        "shoulder": DRIVE,
        "elbow": DRIVE,
        "zero": {"shoulder": LEVEL_UP, "elbow": 0.3},
    },
    "base held": {"base": 0.7, "shoulder": DRIVE, "elbow": passive()},
}


@pytest.mark.parametrize("part", PARTS)
def test_torques_are_those_of_point_masses_in_space(part):
    machine = mechanism(**PARTS[part])
    oracle, rng = PointMasses(machine.body), np.random.default_rng(3)
    q, qd, qdd = rng.uniform(-2.0, 2.0, size=(3, 20, machine.joints))
    expected = [oracle.torque(*row) for row in zip(q, qd, qdd)]
    assert_allclose(machine.torque(None, q, qd, qdd), expected, atol=2e-8)
    still = np.zeros_like(q)
    assert_allclose(machine.gravity(None, q), [oracle.torque(row, *still[:2]) for row in q], atol=1e-10)
    for n, unit in enumerate(np.eye(machine.joints)):
        own = [oracle.torque(row, still[0], unit, gravity=0.0) for row in q]
        assert_allclose(machine.inertia_matrix(None, q)[:, :, n], own, atol=1e-10)


@pytest.mark.parametrize("part", PARTS)
def test_the_simulator_moves_by_the_torques_of_the_mechanism(part):
    """Inverse dynamics of the motion that the kernel makes of torques give these torques back."""
    machine = mechanism(**PARTS[part])
    J, time = machine.joints, np.arange(0.0, 1.0, 1e-3)
    torque = 0.8 * np.sin(7.0 * time[:, None] + np.arange(J)) * np.array(machine.driven)
    simulator = Simulator(machine.plant())
    simulator.reset(np.array([0.2, -0.6, 0.9])[:J])
    run = simulator.run(time, torque, acceleration=True)
    assert np.ptp(run.position, axis=0).min() > 1e-3
    assert_allclose(machine.torque(None, run.position, run.velocity, run.acceleration), torque, atol=1e-9)


def test_a_double_pendulum_moves_as_in_textbooks():
    """Two point masses on rods without mass: the equations with absolute angles (Goldstein, section 1.6)."""
    m1, m2, l1, l2, g = 0.7, 0.4, 0.5, 0.3, 9.81
    numbers = {
        "shoulder": {"mass": m1, "length": l1, "centre": l1, "across": 0.0, "inertia": 0.0},
        "elbow": {"mass": m2, "centre": l2, "across": 0.0, "inertia": 0.0},
    }
    time, start = np.arange(0.0, 3.0, 0.002), [1.2, -0.5]
    simulator = Simulator(plant(shoulder=passive(), elbow=passive(), numbers=numbers), max_step=5e-4)
    simulator.reset(start)
    run = simulator.run(time, np.zeros((len(time), 2)))

    def slope(_, x):
        a, b, u, v = x
        c, s = np.cos(a - b), np.sin(a - b)
        matrix = [[(m1 + m2) * l1, m2 * l2 * c], [l1 * c, l2]]
        right = [-m2 * l2 * v**2 * s - (m1 + m2) * g * np.sin(a), l1 * u**2 * s - g * np.sin(b)]
        return [u, v, *np.linalg.solve(matrix, right)]

    expected = solve_ivp(slope, (0.0, time[-1]), [start[0], sum(start), 0.0, 0.0], t_eval=time, rtol=1e-11, atol=1e-12)
    absolute = np.cumsum(run.position, axis=1)
    assert_allclose(absolute, expected.y[:2].T, atol=1e-6)
    a, b = absolute.T
    u, v = np.cumsum(run.velocity, axis=1).T
    kinetic = 0.5 * (m1 + m2) * (l1 * u) ** 2 + 0.5 * m2 * (l2 * v) ** 2 + m2 * l1 * l2 * u * v * np.cos(a - b)
    energy = kinetic - (m1 + m2) * g * l1 * np.cos(a) - m2 * g * l2 * np.cos(b)
    assert kinetic.max() > 1.0 and np.ptp(energy) < 1e-7


def test_a_rotary_pendulum_moves_as_its_own_equations():
    """Equations of Cazzolato and Prime 2011 (J. Control Science and Engineering 528341), without friction."""
    J1, m, L, r, J2, g = 0.003, 0.05, 0.12, 0.08, 1.3e-4, 9.81
    numbers = {
        "base": {"inertia": J1},
        "shoulder": {
            "mass": m,
            "centre": r,
            "across": 0.0,
            "beside": L,
            "inertia": J2,
            "inertia_along": 0.0,
            "inertia_across": J2,
        },
    }
    body = {"base": torque_drive(), "shoulder": passive(), "numbers": numbers}
    time, start = np.arange(0.0, 2.0, 0.002), [0.0, 0.4]
    torque = 0.02 * np.sin(9.0 * time)
    simulator = Simulator(plant(**body), max_step=5e-4)
    simulator.reset(start)
    run = simulator.run(time, np.column_stack([torque, np.zeros_like(time)]))
    swing = J2 + m * r**2

    def slope(push):
        def rates(_, x):
            _, b, u, v = x
            c, s = np.cos(b), np.sin(b)
            # the mass stands at L beside the axis and swings across it
            matrix = [[J1 + m * L**2 + swing * s**2, m * L * r * c], [m * L * r * c, swing]]
            right = [push - 2.0 * swing * s * c * u * v + m * L * r * s * v**2, swing * s * c * u**2 - m * g * r * s]
            return [u, v, *np.linalg.solve(matrix, right)]

        return rates

    states = [np.array([*start, 0.0, 0.0])]
    for n in range(len(time) - 1):
        part = solve_ivp(slope(torque[n]), (time[n], time[n + 1]), states[-1], rtol=1e-10, atol=1e-12)
        states.append(part.y[:, -1])
    assert_allclose(run.position, np.array(states)[:, :2], atol=1e-7)


def test_a_held_axis_stays_and_a_held_base_changes_nothing():
    free, held = (mechanism(**axes, shoulder=DRIVE, elbow=DRIVE) for axes in ({}, {"base": 0.4}))
    q = np.random.default_rng(1).uniform(-1.0, 1.0, size=(3, 9, 2))
    assert np.array_equal(free.torque(None, *q), held.torque(None, *q))
    simulator = Simulator(plant(**PARTS["rotary pendulum on a held arm"]))
    simulator.reset([0.1, 0.5])
    simulator.run(np.arange(0.0, 0.5, 1e-3), np.zeros((500, 2)))
    assert simulator.state[1] == 1.2 + 0.5 * pi and simulator.state[4] == 0.0


def test_model_files_and_known_numbers(tmp_path):
    for part, given in PARTS.items():
        machine = plant([parse_effect("coulomb_friction:joint=1,torque=0.1")], **given)
        dump_model(machine, tmp_path / "model.yaml")
        assert load_model(tmp_path / "model.yaml") == machine, part


def test_effects_of_a_linkage_are_on_the_joints_that_move():
    body = {"base": torque_drive(), "shoulder": passive()}
    machine = mechanism(**body)
    for name, joint, possible in (
        ("coulomb_friction", 2, True),
        ("voltage_offset", 1, True),
        ("voltage_offset", 2, False),
        ("voltage_offset", None, True),
        ("joint_elasticity", 1, False),
        ("base_tilt", None, True),
        ("resistance_drift", 1, False),
        ("input_delay", None, True),
    ):
        assert machine.possible(name, joint) == possible, (name, joint)
    assert not mechanism(shoulder=DRIVE, elbow=DRIVE).possible("base_tilt")
    with pytest.raises(ParameterError, match="the shoulder of 'test' has no drive"):
        plant([parse_effect("voltage_offset:joint=2,voltage=1")], **body)
    with pytest.raises(ParameterError, match="joint=1 to 2: 'test' has 2 joints"):
        plant([parse_effect("coulomb_friction:joint=3,torque=1")], **body)
    # friction of the passive joint slows its swing alone
    time = np.arange(0.0, 2.0, 0.005)
    runs = []
    for effects in ((), (parse_effect("coulomb_friction:joint=2,torque=1.5"),)):
        simulator = Simulator(plant(effects, **body))
        simulator.reset([0.0, 1.0])
        runs.append(simulator.run(time, np.zeros((len(time), 2))))
    assert np.abs(runs[0].velocity[-100:, 1]).max() > 1.0 and not runs[1].velocity[-1, 1]


def test_base_tilt_of_a_rotary_pendulum_is_gravity_along_the_other_axes():
    machine = mechanism(base=DRIVE, shoulder=passive(), zero={"shoulder": -0.9})
    oracle = PointMasses(machine.body)
    q = np.random.default_rng(4).uniform(-2.0, 2.0, size=(8, 2))
    tilt = machine.gravity_tilt(None, q)
    for row, found in zip(q, tilt):
        mass, _ = oracle.places(row)
        columns = [np.imag(oracle.places(row + 1e-30j * unit)[1]) / 1e-30 for unit in np.eye(2)]
        for axis in (0, 1):
            expected = [-9.81 * (mass * column[:, axis]).sum() for column in columns]
            assert_allclose(found[:, axis], expected, atol=1e-12)


FREE_ZEROS = {
    "pendulum": ({"shoulder": DRIVE}, {"shoulder": 0.4}),
    "double pendulum": ({"shoulder": DRIVE, "elbow": DRIVE}, {"shoulder": 0.0, "elbow": -0.7}),
    "rotary pendulum": ({"base": DRIVE, "shoulder": passive()}, {"shoulder": pi}),
    "elbow on a held shoulder": ({"shoulder": 0.9, "elbow": DRIVE}, {"elbow": 0.1}),
}


@pytest.mark.parametrize("part", FREE_ZEROS)
def test_a_zero_with_a_deviation_is_a_parameter(part, tmp_path):
    axes, zeros = FREE_ZEROS[part]
    fixed = mechanism(**axes, zero=zeros)
    machine = mechanism(**axes, zero={place: (value, 0.1) for place, value in zeros.items()})
    assert [p.name for p in machine.free] == [f"{place}.zero" for place in zeros]
    assert_allclose(machine.start, list(zeros.values()))
    off = np.array([0.08, -0.13])[: len(zeros)]
    joints = [axis.place for axis in machine.body.moving]
    shift = np.zeros(machine.joints)
    shift[[joints.index(place) for place in zeros]] = off
    theta = machine.start + off
    q, qd, qdd = np.random.default_rng(5).uniform(-2.0, 2.0, size=(3, 20, machine.joints))
    # a joint that is `off` from where it says to be
    assert_allclose(machine.torque(theta, q, qd, qdd), fixed.torque(None, q + shift, qd, qdd), atol=1e-13)
    assert_allclose(machine.gravity(theta, q), fixed.gravity(None, q + shift), atol=1e-13)
    assert_allclose(machine.inertia_matrix(theta, q), fixed.inertia_matrix(None, q + shift), atol=1e-13)
    slopes = machine.link_jacobian(theta, q, qd, qdd)
    for n in range(len(theta)):
        step = 1e-6 * np.eye(len(theta))[n]
        ends = (machine.torque(theta + sign * step, q, qd, qdd) for sign in (1.0, -1.0))
        assert_allclose(slopes[:, :, n], (next(ends) - next(ends)) / 2e-6, atol=1e-8)
    time = np.arange(0.0, 0.5, 1e-3)
    runs = []
    for plant_of, start in ((machine.plant(theta), np.zeros(machine.joints)), (fixed.plant(), shift)):
        simulator = Simulator(plant_of)
        simulator.reset(start)
        runs.append(simulator.run(time, np.zeros((len(time), machine.joints))).position - start)
    assert_allclose(*runs, atol=1e-12)
    # it is what an encoder's offset would be, and written and read again as a prior
    for joint, place in enumerate(joints, start=1):
        assert machine.possible("encoder_offset", joint) == (place not in zeros)
        assert fixed.possible("encoder_offset", joint)
    dump_model(machine.plant(theta), tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again == machine.plant(theta)
    assert_allclose(LinkageMechanism.of(again.body).start, theta)


def test_the_zero_of_a_pendulum_is_that_of_a_shoulder():
    mapping = linkage_mapping(load_mechanism("pendulum").body)
    mapping["zero"] = {"value": 0.2, "unit": "rad", "deviation": 0.05}
    lever = LinkageMechanism.of(read_linkage(mapping))
    assert next(p.name for p in lever.free) == "zero" and lever.start[0] == 0.2
    assert not lever.possible("encoder_offset", 1)
    body = {name: entry for name, entry in mapping["body"].items() if name not in ("gravity", "length")}
    body |= {"centre": mapping["body"]["length"], "inertia": {"value": 0.0, "unit": "kg.m^2", "known": True}}
    shoulder = {"link": body, **{key: mapping[key] for key in ("range", "torque_scale", "zero", "drive")}}
    parts = {"gravity": mapping["body"]["gravity"], "shoulder": shoulder}
    whole = LinkageMechanism.of(read_linkage({"format": mapping["format"], "name": "x", "kind": "linkage", **parts}))
    theta = lever.start * (1.5, 1.1, 0.9, 1.2, 0.8)
    runs = []
    for machine in (lever, whole):
        simulator = Simulator(machine.plant(theta))
        simulator.reset((0.1,))
        runs.append(simulator.run(np.arange(0.0, 1.0, 0.01), np.ones((100, 1))).position)
    assert np.array_equal(*runs)
    # written and read again, of a start of zero too
    for value in (0.2, 0.0):
        mapping["zero"]["value"] = value
        read = read_linkage(mapping)
        assert read_linkage(linkage_mapping(read)) == read
    slide = linkage_mapping(load_mechanism("slide").body) | {"zero": mapping["zero"]}
    with pytest.raises(ParameterError, match="zero: unknown key"):
        read_linkage(slide)


@pytest.mark.filterwarnings("error")
def test_what_a_linkage_cannot_be():
    free = {"shoulder": (LEVEL_DOWN, 0.1)}
    with pytest.raises(ParameterError, match=r"shoulder\.zero\.deviation: beside a base and an elbow"):
        linkage(base=DRIVE, shoulder=DRIVE, elbow=DRIVE, zero=free)
    with pytest.raises(ParameterError, match=r"shoulder\.zero\.deviation: of an axis that is held"):
        linkage(shoulder=0.9, elbow=DRIVE, zero={"shoulder": (0.2, 0.1)})
    for given, words in (
        ({"elbow": DRIVE}, "a shoulder before the elbow"),
        ({"shoulder": 0.3}, "one at least with a drive, or passive"),
        ({"base": DRIVE, "shoulder": DRIVE, "elbow": DRIVE}, "shoulder.zero -1.5707963"),
        ({"shoulder": DRIVE, "numbers": {"shoulder": {"mass": 0.0, "inertia": 0.0}}}, "above 0 that each joint moves"),
        ({"shoulder": DRIVE, "gravity": -1.0}, "gravity.value: -1.0"),
    ):
        with pytest.raises(ParameterError, match=words):
            linkage(**given)
    long = linkage(base=DRIVE, shoulder=DRIVE, numbers={"shoulder": {"inertia_along": 1.0}})
    with pytest.raises(
        ParameterError, match="here: shoulder.link: inertia, .* none greater than the sum of the others"
    ):
        check_bodies(long, Reader("here"))


def test_a_pendulum_is_a_linkage_of_a_shoulder():
    single = load_mechanism("pendulum")
    v = single.body.values
    numbers = {"mass": v["mass"], "centre": v["length"], "across": 0.0, "inertia": 0.0}
    drive = torque_drive(v["viscous_friction"], v["motor_inertia"])
    twin = mechanism(shoulder=drive, numbers={"shoulder": numbers})
    q = np.random.default_rng(2).uniform(-2.0, 2.0, size=(3, 9, 1))
    assert_allclose(single.torque(None, *q), twin.torque(None, *q), rtol=1e-14)
    assert_allclose(single.total_torque(None, *q), twin.total_torque(None, *q), rtol=1e-14)


def test_sizes_of_the_library_are_those_of_its_own_arm_alone():
    """A linkage of three joints is another machine, whatever their number."""
    three = mechanism(**PARTS["whole arm, level and down"])
    arm = load_mechanism("puma560")
    assert three.joints == arm.joints == 3 and arm.library_sized and not three.library_sized
    with pytest.raises(ParameterError, match="a model of kind linkage; expected a model of an arm"):
        arm.of_plant(three.plant())


@pytest.mark.parametrize("key", ["zero", "held"])
def test_angles_of_links_are_within_a_turn_or_so(key):
    mapping = linkage_mapping(linkage(shoulder=0.5, elbow=torque_drive()))
    mapping["shoulder"][key] = {"value": 1e9, "unit": "rad"}
    with pytest.raises(ParameterError, match=rf"shoulder\.{key}\.value: .*; expected a finite number from -10 to 10"):
        read_linkage(mapping)
