# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Parameter sets: what they hold, that files keep every digit, and that bad ones are named."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml

from puma_sim_core.arm.arm import Link
from puma_sim_core.arm.parameters import (
    check_parameters,
    from_mapping,
    load_parameters,
    parameter_sets,
    smallest_eigenvalue,
    to_mapping,
)
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.files import write_yaml
from puma_sim_core.resources import config_path

SETS = ["bejczy", "armstrong", "average", "corke_armstrong_1994", "paul", "tuned"]
THESIS_SETS = [name for name in SETS if name != "corke_armstrong_1994"]


@pytest.fixture(params=SETS)
def arm(request):
    return load_parameters(request.param)


@pytest.fixture
def mapping():
    return to_mapping(load_parameters("bejczy"))


def column(arm, key):
    return [getattr(link, key) for link in arm.links]


# ------------------------------------------------------------------------------------ contents


def test_published_sets_with_the_default_first():
    assert parameter_sets() == SETS


def test_default_set_has_the_numbers_of_table_4_2():
    arm = load_parameters("bejczy")
    assert column(arm, "mass") == [12.96, 22.37, 6.97]
    assert column(arm, "centre") == [(0, 0.3088, 0.0389), (-0.3289, 0.0050, 0.2038), (0.0136, 0.0092, 0.1522)]
    assert column(arm, "gyration_squared") == [
        (0.1816, 0.0152, 0.1811),
        (0.0596, 0.1930, 0.1514),
        (0.0783, 0.0786, 0.0021),
    ]
    assert column(arm, "products") == [(0, 0, 0)] * 3
    assert list(arm.motor_inertia) == [0.7766, 2.3616, 0.5827]
    assert (arm.a2, arm.a3, arm.d3, arm.gravity) == (0.4318, -0.0191, 0.1505, 9.81)


def test_average_is_the_mean_of_two_sets():
    average, first, second = map(load_parameters, ("average", "bejczy", "armstrong"))
    for key in ("mass", "centre", "gyration_squared"):
        np.testing.assert_allclose(
            column(average, key), np.mean([column(first, key), column(second, key)], axis=0), rtol=1e-15, atol=0
        )
    np.testing.assert_allclose(average.motor_inertia, (first.motor_inertia + second.motor_inertia) / 2, rtol=1e-15)


def test_tuned_is_marked_as_a_reconstruction_and_nominal_but_for_its_radii():
    tuned, nominal = load_parameters("tuned"), load_parameters("bejczy")
    assert "RECONSTRUCTION" in tuned.source
    assert column(tuned, "gyration_squared") == [
        (0.1802, 0.0141, 0.1800),
        (0.0516, 0.1900, 0.1514),
        (0.0510, 0.0691, 0.0027),
    ]
    restored = tuple(
        replace(link, gyration_squared=other.gyration_squared) for link, other in zip(tuned.links, nominal.links)
    )
    assert restored == nominal.links and tuned.motors == nominal.motors


@pytest.mark.parametrize("name", THESIS_SETS)
def test_motors_are_those_of_section_5_1(name):
    for motor, ratio in zip(load_parameters(name).motors, (62.55, 107.81, 53.63)):
        assert (motor.resistance, motor.inductance, motor.back_emf, motor.torque_constant, motor.gear_ratio) == (
            1.6,
            0.0048,
            0.26,
            0.2611,
            ratio,
        )


def test_joint_ranges(arm):
    np.testing.assert_allclose(np.degrees(arm.joint_ranges), [(-160, 160), (-223, 43), (-52, 232)], atol=1e-13)


def test_suggested_effects_can_be_used_and_are_not_active():
    for name, count in (("corke_armstrong_1994", 6), ("tuned", 3), ("bejczy", 0)):
        effects = [parse_effect(text) for text in load_parameters(name).suggested_effects]
        assert len(effects) == count
        assert [effect.joint for effect in effects] == [1, 2, 3] * (count // 3)


def test_suggested_friction_is_that_of_the_source_at_the_joints():
    values = {}
    for text in load_parameters("corke_armstrong_1994").suggested_effects:
        effect = parse_effect(text)
        values[effect.kind.name, effect.joint] = effect.values
    motors = {
        1: (62.6111, 1.48e-3, 0.395, 0.435),
        2: (107.815, 0.817e-3, 0.126, 0.071),
        3: (53.7063, 1.38e-3, 0.132, 0.105),
    }
    for joint, (ratio, viscous, plus, minus) in motors.items():
        # given to two or three digits
        assert values["viscous_friction", joint]["coefficient"] == pytest.approx(ratio**2 * viscous, rel=2e-3)
        dry = values["asymmetric_coulomb_friction", joint]
        assert dry["positive"] == pytest.approx(ratio * plus, rel=8e-3)
        assert dry["negative"] == pytest.approx(ratio * minus, rel=8e-3)


def test_every_number_of_the_files_has_unit_and_source():
    def numbers(node, key):
        if isinstance(node, dict) and "value" in node:
            assert set(node) == {"value", "unit", "source"} and node["source"], key
            return 1
        if isinstance(node, dict):
            return sum(numbers(entry, f"{key}.{name}") for name, entry in node.items())
        if isinstance(node, list):
            assert all(set(entry) == {"effect", "source"} for entry in node), key
            return 0
        assert not isinstance(node, (int, float)), key
        return 0

    for path in config_path("parameters").glob("*.yaml"):
        count = numbers(yaml.safe_load(path.read_text(encoding="utf-8")), path.stem)
        assert count >= 4 + 1 + 9 + 18 + 3


# ---------------------------------------------------------------------------------- conversion


def converted_link(mass, centre, central, turn):
    """Numbers of a link about its frame's origin, from moments about its centre of mass.

    centre, central : (3,) in the source's frame, the second the principal moments [kg.m^2] along
    its axes; turn : rotation from the source's frame to ours. The second moments of mass add:
    those about the centre, (trace I / 2 - I) / m, and those of the centre itself.
    """
    centre = turn @ np.array(centre)
    central = turn @ np.diag(central) @ turn.T
    second = (np.trace(central) / 2 * np.eye(3) - central) / mass + np.outer(centre, centre)
    x2, y2, z2 = np.diag(second)
    return Link(mass, tuple(centre), (y2 + z2, x2 + z2, x2 + y2), (second[0, 1], second[1, 2], second[0, 2]))


def test_corke_armstrong_is_converted_from_the_frames_of_its_source():
    arm = load_parameters("corke_armstrong_1994")
    half_turn = np.diag([-1.0, -1.0, 1.0])
    expected = [
        converted_link(17.4, (-0.3638, 0.006, 0.2275), (0.13, 0.524, 0.539), np.eye(3)),
        converted_link(4.8, (-0.0203, -0.0141, 0.070), (0.066, 0.086, 0.0125), half_turn),
    ]
    for link, other in zip(arm.links[1:], expected):
        assert link.mass == other.mass
        for key in ("centre", "gyration_squared", "products"):
            np.testing.assert_allclose(getattr(link, key), getattr(other, key), rtol=0, atol=1e-16, err_msg=key)
        assert all(link.products)
    assert arm.links[0].mass * arm.links[0].gyration_squared[1] == 0.35
    assert (arm.a2, arm.a3, arm.d3) == (0.4318, -0.0203, 0.15005)
    ratios = np.array([62.6111, 107.815, 53.7063])
    assert [motor.gear_ratio for motor in arm.motors] == list(ratios)
    np.testing.assert_allclose(arm.motor_inertia, 200e-6 * ratios**2, rtol=1e-15)


def test_pseudo_inertia_is_the_integral_over_the_mass():
    rng = np.random.default_rng(9)
    points, weights = rng.normal(size=(7, 3)), rng.uniform(0.5, 2, 7)
    x, y, z = points.T
    mass = weights.sum()

    def mean(values):
        return weights @ values / mass

    link = Link(
        mass,
        (mean(x), mean(y), mean(z)),
        (mean(y * y + z * z), mean(x * x + z * z), mean(x * x + y * y)),
        (mean(x * y), mean(y * z), mean(x * z)),
    )
    homogeneous = np.column_stack([points, np.ones(7)])
    np.testing.assert_allclose(link.pseudo_inertia, (homogeneous.T * weights) @ homogeneous, rtol=1e-13, atol=1e-14)


# --------------------------------------------------------------------------------- round trips


def test_mapping_gives_back_an_equal_value(arm):
    again = from_mapping(to_mapping(arm))
    assert again == arm and hash(again) == hash(arm) and again.sources.keys() == arm.sources.keys()


def test_file_gives_back_an_equal_value(arm, tmp_path):
    write_yaml(to_mapping(arm), tmp_path / "arm.yaml")
    again = load_parameters(tmp_path / "arm.yaml")
    assert again == arm
    assert {key: text for key, (_, text) in again.sources.items()} == {
        key: text for key, (_, text) in arm.sources.items()
    }
    write_yaml(to_mapping(again), tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "arm.yaml").read_bytes()


def test_every_digit_survives_the_file(tmp_path):
    arm = load_parameters("bejczy")
    mass = math.nextafter(6.97, 7.0)
    changed = replace(
        arm,
        gravity=math.pi * 3.1,
        links=(*arm.links[:2], replace(arm.links[2], mass=mass)),
        joint_ranges=((-1e-3, 2e-30), *arm.joint_ranges[1:]),
    )
    write_yaml(to_mapping(changed), tmp_path / "arm.yaml")
    assert load_parameters(tmp_path / "arm.yaml") == changed


def test_a_replaced_number_loses_its_source(mapping):
    arm = load_parameters("bejczy")
    link3 = replace(arm.links[2], mass=7.0)
    changed = to_mapping(replace(arm, links=(*arm.links[:2], link3)))
    assert "source" not in changed["links"]["link3"]["mass"]
    assert changed["links"]["link3"]["centre"]["source"] == "thesis table 4.2, row 3*"
    assert mapping["links"]["link3"]["mass"]["source"] == "thesis table 4.2, row 3*"


def test_angles_may_be_degrees_and_numbers_of_other_yaml_spellings(mapping, tmp_path):
    text = yaml.safe_dump(mapping)
    text = re.sub(r"(inertia:\n(?:.*\n){0,2}?\s+unit: kg.m\^2\n\s+value: )0.7766", r"\g<1>7766e-4", text)
    assert "7766e-4" in text
    path = tmp_path / "arm.yaml"
    path.write_text(text)
    assert load_parameters(path) == load_parameters("bejczy")
    mapping["joint_ranges"]["joint1"] = {"value": [-90, 180], "unit": "deg"}
    assert from_mapping(mapping).joint_ranges[0] == (-math.pi / 2, math.pi)


# ----------------------------------------------------------------------------------- bad input


def put(mapping, path, value):
    *keys, last = path.split(".")
    for key in keys:
        mapping = mapping[key]
    if value is None:
        del mapping[last]
    else:
        mapping[last] = value
    return mapping


@pytest.mark.parametrize(
    "path, value, message",
    [
        ("colour", "blue", "colour: unknown key; expected one of name, source,"),
        ("links.link2.weight", {"value": 1, "unit": "kg"}, "links.link2.weight: unknown key"),
        ("links.link4", {}, "links.link4: unknown key; expected one of link1, link2, link3"),
        ("links.link2.mass.error", 0.1, "links.link2.mass.error: unknown key"),
        ("motors.joint3", None, "motors.joint3: missing"),
        ("gravity", None, "gravity: missing"),
        ("links.link2.mass.unit", None, "links.link2.mass.unit: missing"),
        ("links.link2.mass.unit", "g", "links.link2.mass.unit: unit 'g'; expected kg"),
        ("geometry.a2.unit", "mm", "geometry.a2.unit: unit 'mm'; expected m"),
        ("joint_ranges.joint1.unit", "grad", "unit 'grad'; expected rad or deg"),
        ("links.link2.mass", 22.37, "links.link2.mass: 22.37 without a unit; expected {value: ...,"),
        ("links.link2.mass.value", "heavy", "links.link2.mass.value: 'heavy'; expected a finite"),
        ("links.link2.mass.value", "22.37", "links.link2.mass.value: '22.37'; expected a finite"),
        ("links.link2.mass.value", True, "True; expected a finite number"),
        ("links.link2.mass.value", [1.0], "[1.0]; expected a finite number"),
        ("links.link2.mass.value", math.nan, "nan; expected a finite number"),
        ("links.link2.mass.value", 10**400, "expected a finite number"),
        ("links.link2.centre.value", [0.1, 0.2], "[0.1, 0.2]; expected 3 finite numbers"),
        ("links.link2.centre.value", 0.1, "0.1; expected 3 finite numbers"),
        ("links.link2.centre.value", [0.1, math.inf, 0], "inf; expected a finite number"),
        ("links.link2.centre.value", [0.1, "x", 0], "'x'; expected a finite number"),
        ("joint_ranges.joint2.value", [1.0], "[1.0]; expected 2 finite numbers"),
        ("joint_ranges.joint2.value", [1.0, -1.0], "joint_ranges.joint2: from 1.0 to -1.0 rad"),
        ("links.link1.mass.value", 0, "links.link1.mass: 0.0; expected a number above 0 kg"),
        ("motors.joint2.inductance.value", -1e-3, "motors.joint2.inductance: -0.001; expected a"),
        ("motors.joint2.gear_ratio.value", -107.81, "motors.joint2.gear_ratio: -107.81; expected a"),
        ("motors.joint2.inertia.value", -2.0, "motors.joint2.inertia: -2.0; expected no number below"),
        ("gravity.value", -9.81, "gravity: -9.81; expected no number below 0 m/s^2"),
        ("links", [1, 2, 3], "links: [1, 2, 3]; expected a mapping with the keys link1, link2, link3"),
        ("name", 7, "name: 7; expected text"),
        ("links.link1.mass.source", 3, "links.link1.mass.source: 3; expected text"),
        ("suggested_effects", "viscous", "suggested_effects: 'viscous'; expected a list"),
        ("suggested_effects", ["viscous friction"], "suggested_effects[1]: 'viscous friction'"),
    ],
    ids=lambda value: value if isinstance(value, str) and " " not in value else "",
)
def test_bad_entries_are_named(mapping, path, value, message):
    put(mapping, path, value)
    with pytest.raises(ParameterError) as caught:
        from_mapping(mapping, where="arm.yaml")
    assert str(caught.value).startswith("arm.yaml: ") and message in str(caught.value)
    with pytest.raises(ParameterError) as caught:
        from_mapping(mapping)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", "arm.yaml: None; expected a mapping with the keys name,"),
        (b"- 1\n- 2\n", "expected a mapping"),
        (b"name: a\nname: b\n", "line 2: not usable as YAML (key 'name' stands twice)"),
        (b"name: [1, 2\nsource: x\n", "not usable as YAML"),
        (b"name: \xff\xfe\n", "cannot be read"),
        (b"name: !!python/object:os.system x\n", "not usable as YAML"),
    ],
    ids=["empty", "list", "repeated key", "broken", "not text", "object"],
)
def test_files_that_are_no_parameters(tmp_path, content, message):
    path = tmp_path / "arm.yaml"
    path.write_bytes(content)
    with pytest.raises(ParameterError) as caught:
        load_parameters(path)
    assert str(path) in str(caught.value) and message in str(caught.value)


def test_truncated_file_is_refused(tmp_path):
    text = config_path("parameters", "paul.yaml").read_text(encoding="utf-8")
    path = tmp_path / "arm.yaml"
    for part in range(1, 20):
        path.write_text(text[: len(text) * part // 20], encoding="utf-8")
        with pytest.raises(ParameterError, match="arm.yaml"):
            load_parameters(path)


@pytest.mark.parametrize("name", ["puma", "missing.yaml", "."])
def test_unknown_set_or_file_lists_the_sets(name):
    with pytest.raises(ParameterError, match="no parameter set or file .* bejczy, armstrong"):
        load_parameters(name)


# -------------------------------------------------------------------------- positive definiteness


def table_7_1(k2xx):
    """The tuned parameters as table 7.1 prints them, but for the sign of k2xx squared."""
    arm = load_parameters("bejczy")
    radii = [(0.1802, 0.1800, 0.0141), (k2xx, 0.1900, 0.0031), (0.0510, 0.0691, 0.0027)]
    return replace(
        arm,
        name="as printed",
        links=tuple(replace(link, gyration_squared=k) for link, k in zip(arm.links, radii)),
        motors=tuple(replace(motor, inertia=ia) for motor, ia in zip(arm.motors, (0.1816, 0.2361, 0.0590))),
    )


def test_table_7_1_as_printed_is_refused():
    printed = table_7_1(-0.0516)
    with pytest.raises(ParameterError, match="links.link2.gyration_squared: -0.0516; expected no number below 0"):
        check_parameters(printed)
    whole_turns = replace(printed, joint_ranges=((-math.pi, math.pi),) * 3)
    assert abs(smallest_eigenvalue(whole_turns)[0] + 2.36) < 0.005


def test_error_names_the_pose_and_the_eigenvalue():
    from puma_sim_core.arm.rigid_body import inertia

    arm = table_7_1(0.0516)
    with pytest.raises(ParameterError) as caught:
        check_parameters(arm, where="tuned.yaml")
    found = re.fullmatch(
        r"tuned.yaml: D \+ Ia is not positive definite: its smallest eigenvalue is (\S+) kg.m\^2 "
        r"at q2 = (\S+) deg, q3 = (\S+) deg; expected eigenvalues above 0 over the joint ranges",
        str(caught.value),
    )
    value, q2, q3 = map(float, found.groups())
    matrix = inertia(np.radians([0, q2, q3]), arm) + np.diag(arm.motor_inertia)
    assert value < -1.7
    # the pose is given to a tenth of a degree
    assert abs(np.linalg.eigvalsh(matrix)[0] - value) < 0.005


def test_smallest_eigenvalue_is_not_missed_between_the_poses(arm):
    # against a grid of 1 degree over the same ranges; two almost equal minima may be far apart
    from puma_sim_core.arm.rigid_body import inertia

    (low2, high2), (low3, high3) = arm.joint_ranges[1:]
    q2, q3 = np.meshgrid(np.linspace(low2, high2, 267), np.linspace(low3, high3, 285))
    poses = np.stack([0 * q2, q2, q3], axis=-1)
    values = np.linalg.eigvalsh(inertia(poses, arm) + np.diag(arm.motor_inertia))
    lowest, at2, at3 = smallest_eigenvalue(arm)
    assert 0 < lowest <= values.min() + 1e-6
    assert low2 <= at2 <= high2 and low3 <= at3 <= high3


@pytest.mark.parametrize("name, lowest", [("bejczy", 0.760), ("tuned", 0.700)])
def test_smallest_eigenvalue_of_known_sets(name, lowest):
    assert abs(smallest_eigenvalue(load_parameters(name))[0] - lowest) < 5e-4


def test_only_the_joint_ranges_count():
    # with a tenth of the motor inertias the arm fails upright and not about the stretched pose
    arm = load_parameters("bejczy")
    arm = replace(arm, motors=tuple(replace(m, inertia=m.inertia / 10) for m in arm.motors))
    with pytest.raises(ParameterError, match="not positive definite"):
        check_parameters(arm)
    stretched = math.pi / 2
    check_parameters(replace(arm, joint_ranges=(arm.joint_ranges[0], (-0.2, 0.2), (stretched - 0.2, stretched + 0.2))))


def test_numbers_that_overflow_are_refused():
    arm = load_parameters("bejczy")
    huge = replace(arm, links=(*arm.links[:2], replace(arm.links[2], mass=1e308, gyration_squared=(9.0, 9.0, 9.0))))
    with pytest.raises(ParameterError, match="eigenvalue is nan"):
        check_parameters(huge)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"links": ()}, "links.link: 0 entries"),
        ({"motors": ()}, "motors.joint: 0 entries"),
        ({"joint_ranges": ()}, "joint_ranges.joint: 0 entries"),
        ({"a3": "short"}, "geometry.a3: 'short'"),
    ],
)
def test_values_made_in_python_are_checked_too(change, message):
    with pytest.raises(ParameterError, match=re.escape(message)):
        check_parameters(replace(load_parameters("bejczy"), **change))


def test_module_is_light():
    code = (
        "import sys, puma_sim_core.arm.parameters; "
        "print(sorted({'scipy', 'numba', 'rclpy', 'mcap', 'matplotlib'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
