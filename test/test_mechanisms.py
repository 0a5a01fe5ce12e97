# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Mechanisms: torques and derivatives, and their files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_support import call
from mechanism_support import NAMES, pendulum, pendulum_mapping, signals_of
from numpy.testing import assert_allclose
from trace_form import arm_table, trace_coriolis, trace_gravity, trace_inertia

from puma_sim_core.arm.kinematics import first_derivatives
from puma_sim_core.arm.rigid_body import arm_pseudo_inertias
from puma_sim_core.checks import Reader
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ModelError, ParameterError, PumaSimError
from puma_sim_core.files import yaml_text
from puma_sim_core.identify.screening.known_effects import known_voltage
from puma_sim_core.plant.linkage.linkage_file import read_linkage
from puma_sim_core.plant.mechanism_file import load_mechanism, mechanism_names
from puma_sim_core.plant.model_file import dump_model, load_model, plant_of_mapping
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording, write_csv
from puma_sim_core.resources import config_path
from puma_sim_core.simulation.simulator import Simulator

OTHERS = (
    *("pendulum", "slide", "dfki_pendulum", "dfki_double_a0", "dfki_double_c0", "dfki_double_c1", "qube_pendulum"),
    *("kuka_kr300", "so101_pitch", "so101_rotation"),
)
RNG = np.random.default_rng(20)


def motion(joints, rows=40):
    return RNG.uniform(-2.0, 2.0, size=(3, rows, joints))


def moved(mechanism, rng=RNG):
    """A theta away from the start, by a few per cent."""
    return mechanism.start * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, len(mechanism.start)))


# ------------------------------------------------------------------------------------- torques


def test_arm_torque_is_that_of_the_trace_form():
    arm = load_mechanism("puma560")
    theta = moved(arm)
    q, qd, qdd = motion(3)
    given = arm.arm_of(theta)
    bodies, table = arm_pseudo_inertias(given), arm_table(given)
    torque, gravity = arm.torque(theta, q, qd, qdd), arm.gravity(theta, q)
    diagonal, matrix = arm.inertia(theta, q), arm.inertia_matrix(theta, q)
    for r in range(len(q)):
        D = trace_inertia(q[r], bodies, table)
        C = trace_coriolis(q[r], bodies, table)
        G = trace_gravity(q[r], bodies, table, given.gravity)
        assert_allclose(torque[r], D @ qdd[r] + np.einsum("ijk,j,k->i", C, qd[r], qd[r]) + G, atol=1e-12)
        assert_allclose(gravity[r], G, atol=1e-12)
        assert_allclose(matrix[r], D, atol=1e-12)
        assert_allclose(diagonal[r], np.diag(D), atol=1e-12)


def test_gravity_tilt_is_gravity_along_the_other_axes_of_the_base():
    load = (parse_effect("payload:mass=2,x=0.1,y=0.05,z=0.3"),)
    arm = load_mechanism("puma560").of_plant(Plant.of("bejczy", load))
    q, _, _ = motion(3, 10)
    tilt = arm.gravity_tilt(arm.start, q)
    moments = arm_pseudo_inertias(arm.plant().loaded_arm)[:, :, 3]
    for r in range(len(q)):
        first = first_derivatives(q[r], arm_table(arm.arm))
        for axis in (0, 1):
            # gravity along the base's x or y axis, in place of down z
            expected = -9.81 * np.einsum("pib,pb->i", first[:, :, axis, :], moments)
            assert_allclose(tilt[r, :, axis], expected, atol=1e-12)
    # joint 1 as loop.md has it, for masses in the plane of the arm
    s1, c1 = np.sin(q[:, 0]), np.cos(q[:, 0])
    flat = arm.gravity(arm.start, q)[:, 1]
    side = tilt[:, 0, 0] + s1 * flat
    assert_allclose(side / c1, (side / c1)[0] * np.ones(len(q)), atol=1e-9)


@pytest.mark.parametrize("name", (*NAMES, "dfki_double_a0", "qube_pendulum"))
def test_derivatives_are_those_of_differences(name):
    mechanism = load_mechanism(name)
    theta = moved(mechanism)
    q, qd, qdd = motion(mechanism.joints, 12)
    torque = mechanism.torque_jacobian(theta, q, qd, qdd)
    drive = mechanism.drive_jacobian(theta)
    assert torque.shape == (12, mechanism.joints, len(theta))
    for n in range(len(theta)):
        step = np.zeros_like(theta)
        step[n] = 1e-5 * (abs(theta[n]) or mechanism.deviations[n])

        def slope(function):
            high, low = function(theta + step), function(theta - step)
            return (np.asarray(high) - np.asarray(low)) / (2.0 * step[n])

        for exact, function in (
            (torque[:, :, n], lambda t: mechanism.total_torque(t, q, qd, qdd)),
            *(
                (getattr(drive, key)[:, n], lambda t, key=key: getattr(mechanism.drive(t), key))
                for key in drive._fields
            ),
        ):
            # rounding of the differences: 1e-16 of the values over the step
            assert_allclose(
                exact,
                slope(function),
                rtol=1e-7,
                atol=1e-10 * (1.0 + abs(np.asarray(function(theta))).max() / step[n] * 1e-5),
            )


def test_payload_torque_is_that_of_a_kilogram_more():
    for name, at in (
        ("puma560", (0.0, 0.0, 0.43)),
        ("puma560", (0.1, -0.05, 0.43)),
        ("pendulum", (0.0, 0.0, 0.07)),
        ("slide", (0.0, 0.0, 1.0)),
    ):
        bare = load_mechanism(name)
        q, qd, qdd = motion(bare.joints, 8)
        x, y, z = at
        load = (parse_effect(f"payload:mass=1,x={x},y={y},z={z}"),)
        loaded = bare.of_plant(bare.plant(bare.start, load))
        difference = loaded.torque(loaded.start, q, qd, qdd) - bare.torque(bare.start, q, qd, qdd)
        assert_allclose(bare.payload_torque(bare.start, at, q, qd, qdd), difference, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("load", [(), ("payload:mass=0.2",)])
def test_model_voltage_is_what_the_simulator_was_given(name, load):
    """Along a motion, Vhat with its lag is the voltage that drove it."""
    mechanism = load_mechanism(name)
    mechanism = mechanism.of_plant(mechanism.plant(None, map(parse_effect, load)))
    theta = moved(mechanism)
    J = mechanism.joints
    size = np.array([6.0, 8.0, 5.0])[:J] if J == 3 else np.array([1.5])
    time = np.arange(0.0, 0.4, 1e-4)
    voltage = size * np.sin(2.0 * np.pi * 1.3 * time[:, None] + np.arange(J))
    simulator = Simulator(mechanism.plant(theta))
    simulator.reset([0.3, -0.5, 1.0][:J])
    run = simulator.run(time, voltage, acceleration=True)
    drive = mechanism.drive(theta)
    motor = mechanism.model_voltage(theta, run.position, run.velocity, run.acceleration)
    lag = drive.lag * np.gradient(motor - drive.emf * run.velocity, time, axis=0)
    # the voltage of a row is held until the next, so that its middle is half a row later
    held = voltage if not drive.lag.any() else 0.5 * (voltage + np.roll(voltage, 1, axis=0))
    rows = slice(300, -2)
    assert_allclose((motor + lag)[rows], held[rows], atol=2e-3 * size.max())


@pytest.mark.parametrize(
    "name, effects",
    [
        (
            "puma560",
            [
                "coulomb_friction:joint=2,torque=9",
                "base_tilt:x=0.05,y=-0.02",
                "input_delay:time=0.004",
                "payload:mass=2",
            ],
        ),
        (
            "puma560",
            [
                "presliding_friction:joint=3,torque=5",
                "supply_droop:coefficient=0.01",
                "torque_ripple:joint=1,amplitude=3,order=1",
                "voltage_dead_band:joint=2,voltage=0.4",
            ],
        ),
        (
            "pendulum",
            ["load_dependent_friction:joint=1,coefficient=0.1", "resistance_drift:joint=1,share=0.3,time_constant=0.5"],
        ),
        (
            "slide",
            [
                "position_dependent_friction:joint=1,torque=15,amplitude=8",
                "impulse:joint=1,torque=40,time=0.5,width=0.2",
            ],
        ),
    ],
)
def test_known_effects_account_for_the_voltage_that_they_take(name, effects):
    bare = load_mechanism(name)
    mechanism = bare.of_plant(bare.plant(None, map(parse_effect, effects)))
    J = mechanism.joints
    time = np.arange(0.0, 1.0, 2e-4)
    voltage = (9.0 if J == 3 else 2.0) * np.sin(6.0 * time[:, None] + np.arange(J))
    simulator = Simulator(mechanism.plant())
    simulator.reset([0.2, -0.6, 0.9][:J])
    run = simulator.run(time, voltage, acceleration=True)
    # at a row the voltage steps: it is the mean of those before and after
    signals = signals_of(mechanism, run, 0.5 * (voltage + np.roll(voltage, 1, axis=0)))
    drive = mechanism.drive(mechanism.start)
    torque = signals.torque
    model = drive.volts_per_torque * (torque + drive.lag * np.gradient(torque, time, axis=0)) + drive.emf * run.velocity
    known = known_voltage(mechanism, mechanism.start, signals)
    rows = slice(200, -2)
    before = np.abs(signals.voltage - model)[rows]
    after = np.abs(signals.voltage - model - known)[rows]
    # apart from the moments in which a joint stops, nothing is left
    assert (np.quantile(after, 0.9, axis=0) < 2e-3 + 0.01 * before.max(axis=0)).all()
    assert before.max() > 0.15
    assert not known_voltage(bare, bare.start, signals).any()


# --------------------------------------------------------------------------------------- files


def test_the_mechanisms_of_the_house():
    assert mechanism_names() == ["puma560", *sorted(OTHERS)]
    sizes = {name: load_mechanism(name) for name in NAMES}
    assert [len(m.parameters) for m in sizes.values()] == [39, 8, 3]
    for mechanism in sizes.values():
        low, high = mechanism.bounds
        assert (low < mechanism.start).all() and (mechanism.start < high).all()
        assert (mechanism.deviations > 0.0).all()
        assert mechanism.plant() == mechanism.plant(mechanism.start)
    assert sizes["slide"].effort_unit == "N" and sizes["slide"].position_unit == "m"
    assert [sizes["slide"].unit(u) for u in ("N.m", "rad", "N.m.s/rad", "V", "1")] == ["N", "m", "N.s/m", "V", "1"]


@pytest.mark.parametrize("name", (*NAMES, "qube_pendulum"))
def test_a_model_file_gives_the_plant_and_the_mechanism_back(name, tmp_path):
    mechanism = load_mechanism(name)
    effects = [
        parse_effect("coulomb_friction:joint=1,torque=0.7"),
        parse_effect("soft_stop:joint=1,stiffness=500,damping=2"),
    ]
    theta = moved(mechanism)
    plant = mechanism.plant(theta, effects)
    path = tmp_path / "model.yaml"
    dump_model(plant, path)
    assert load_model(path) == plant
    assert yaml_text(load_model(path).to_mapping()) == path.read_text()
    again = load_mechanism(name, model=path)
    assert_allclose(again.start, theta, rtol=1e-15)
    assert_allclose(again.deviations / again.start, mechanism.deviations / mechanism.start)
    assert again.plant() == plant
    if name == "slide":
        entry = plant.to_mapping()["effects"][0]
        assert entry["torque"] == {"value": 0.7, "unit": "N"}


def test_a_model_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "model.yaml"
    dump_model(load_mechanism("slide").plant(), path)
    for name in ("puma560", "pendulum"):
        with pytest.raises(ParameterError, match="expected a model of"):
            load_mechanism(name, model=path)
    with pytest.raises(ParameterError, match="with an arm only"):
        load_mechanism("slide", parameters="paul")
    assert load_mechanism(parameters="paul").arm.name == "paul"


def broken(change):
    """The pendulum's file with one change, as (error text)."""
    mapping = pendulum_mapping()
    change(mapping)
    with pytest.raises(PumaSimError) as caught:
        read_linkage(mapping, Reader("rig.yaml"))
    return str(caught.value)


def test_errors_of_a_file_name_key_and_expectation():
    def put(key, **changes):
        def change(mapping):
            group, name = key.split(".")
            mapping[group][name] = {**mapping[group][name], **changes}

        return change

    for change, words in (
        (lambda m: m.update(kind="rope"), ("kind: 'rope'", "pendulum or slide")),
        (lambda m: m.pop("torque_scale"), ("torque_scale: missing",)),
        (lambda m: m["body"].pop("mass"), ("body.mass: missing",)),
        (lambda m: m["body"].update(colour=1), ("body.colour: unknown key", "mass, length")),
        (lambda m: m["body"].update(mass=0.49), ("body.mass: 0.49 without a unit", "kg")),
        (put("body.mass", unit="g"), ("body.mass.unit: unit 'g'", "expected kg")),
        (put("body.length", value=-0.1), ("body.length.value: -0.1", "finite number")),
        (put("drive.resistance", value=float("nan")), ("drive.resistance.value: nan",)),
        (put("body.mass", value=1e30), ("body.mass.value: 1e+30", "from 0 to 1e+06")),
        (put("drive.resistance", value=1e30), ("drive.resistance.value: 1e+30", "above 0, at most 1e+09")),
        (lambda m: m["torque_scale"].update(value=1e30), ("torque_scale.value: 1e+30", "at most 1e+09")),
        (put("drive.resistance", relative_deviation=1e9), ("relative_deviation: 1000000000", "at most 100")),
        (put("drive.resistance", known=True), ("relative_deviation and known", "one of")),
        (put("drive.inductance", value=1e-5), ("time constant of 0.00304 ms", "negligible")),
        (lambda m: m["drive"].update(amplifier="steam"), ("'steam'", "voltage or current")),
        (lambda m: m["range"].update(value=[1.0, -1.0]), ("range.value: from 1 to -1",)),
        (lambda m: m["range"].update(value=[-3.2, 1e30]), ("range.value: from -3.2 to 1e+30", "within 10000 rad")),
        (
            lambda m: m["drive"].update(gain={"value": 1.0, "unit": "N.m/A", "known": True}),
            ("drive.gain: unknown key",),
        ),
    ):
        text = broken(change)
        assert text.startswith("rig.yaml: "), text
        for word in words:
            assert word in text, text


def test_an_error_of_a_mechanism_file_names_line_and_column(tmp_path):
    path = tmp_path / "rig.yaml"
    lines = yaml_text(pendulum_mapping()).splitlines()
    row = next(n for n, line in enumerate(lines) if line.lstrip().startswith("mass:"))
    value = next(n for n in range(row, len(lines)) if lines[n].lstrip().startswith("value:"))
    wrong = [*lines[:value], lines[value].partition(":")[0] + ": heavy", *lines[value + 1 :]]
    missing = [line for n, line in enumerate(lines) if n != value]
    for text, at in ((wrong, value), (missing, row)):
        path.write_text("\n".join(text))
        column = len(text[at]) - len(text[at].lstrip()) + 1
        with pytest.raises(ParameterError, match=rf"rig.yaml, line {at + 1}, column {column}: body.mass.value: "):
            load_mechanism(path)


def test_errors_of_mechanism_and_model_files(tmp_path):
    with pytest.raises(ParameterError, match="one of puma560, dfki_double_a0, .*, slide"):
        load_mechanism("puma")
    path = tmp_path / "arm.yaml"
    text = Path(config_path("mechanisms", "puma560.yaml")).read_text()
    for old, new, words in (
        ("mechanism 1", "mechanism 2", "format: 'puma-sim mechanism 2'"),
        ("parameters: bejczy", "parameters: nobody", "no parameter set or file 'nobody'"),
        ("[5.80, 9.50, 3.98]", "[5.80, 9.50]", "viscous_friction.value"),
        ("  mass: {value: 0.06", "  mass: {value: 6.0", "from 0 to 1"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(ParameterError, match="arm.yaml|nobody") as caught:
            load_mechanism(path)
        assert words in str(caught.value)
    model = pendulum().to_mapping()
    del model["mechanism"]["drive"]
    with pytest.raises(ModelError, match="here mechanism: drive: missing"):
        plant_of_mapping(model, "here")


def test_simulate_takes_a_model_of_one_joint(tmp_path, capsys):
    volts = tmp_path / "volts.csv"
    time = np.arange(0.0, 0.5, 0.01)
    write_csv(Recording(time=time, voltage=np.sin(9.0 * time)[:, None]), volts)
    for name in ("pendulum", "slide"):
        model, out = tmp_path / f"{name}.yaml", tmp_path / f"{name}.csv"
        dump_model(load_mechanism(name).plant(), model)
        assert (
            call(
                "simulate",
                volts,
                "--model",
                model,
                "--initial",
                "0.1",
                "--out",
                out,
                "--effect",
                "coulomb_friction:joint=1,torque=0.001",
            )
            == 0
        )
        assert out.read_text().splitlines()[0] == "time,voltage1,position1,velocity1,current1"
        capsys.readouterr()
        assert call("simulate", out, "--model", model, "--restart", "0.2", "--out", "-") == 0
        unit = "m" if name == "slide" else "rad"
        assert f"windows of 0.2 s [{unit}]" in capsys.readouterr().err
    assert call("simulate", volts, "--model", model, "--initial", "1,2,3", "--out", "-") == 2
    assert "one finite number [m]" in capsys.readouterr().err
