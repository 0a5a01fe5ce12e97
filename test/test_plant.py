# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A plant and its file: what goes in comes out, and what cannot be used is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_reference import bits, plant_of

import puma_sim_core
from puma_sim_core.arm.parameters import load_parameters, parameter_sets
from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.errors import ModelError, ParameterError
from puma_sim_core.files import parse_yaml, yaml_text
from puma_sim_core.plant.model_file import dump_model, load_model
from puma_sim_core.plant.plant import MODEL_FORMAT, Plant
from puma_sim_core.simulation.simulator import Simulator

ALL_EFFECTS = (
    "viscous_friction:joint=1,coefficient=5.8",
    "coulomb_friction:joint=2,torque=12",
    "asymmetric_coulomb_friction:joint=3,positive=7.1,negative=5.6",
    "stribeck_friction:joint=2,torque=3.3,velocity=0.07",
    "presliding_friction:joint=1,stiffness=12345.678901234567,torque=8",
    "voltage_saturation:joint=1",
    "current_limit:joint=3,current=2.5",
    "soft_stop:joint=2",
    "payload:mass=2.5,x=0.1",
    "quadratic_friction:joint=1,coefficient=2.5",
    "load_dependent_friction:joint=3,coefficient=0.1",
    "position_dependent_friction:joint=2,torque=3,amplitude=2,angle=0.4",
    "friction_warm_up:joint=1,share=0.5,time_constant=0.3",
    "voltage_dead_band:joint=1,voltage=0.3",
    "voltage_offset:joint=3,voltage=-0.2",
    "supply_droop:coefficient=0.01",
    "input_delay:time=0.0015",
    "torque_ripple:joint=2,amplitude=2,order=4,phase=1",
    "resistance_drift:joint=2,share=0.2,time_constant=0.4",
    "joint_spring:joint=3,stiffness=12,angle=0.5",
    "base_tilt:x=0.03,y=-0.05",
    "impulse:joint=1,torque=40,time=0.2,width=0.05",
    "sensor_lag:joint=2,time_constant=0.01",
    "encoder_offset:joint=1,angle=0.01",
    "joint_elasticity:joint=3,stiffness=2e4",
    "sensor_nonlinearity:joint=3,amplitude=0.005,period=2,phase=0.3",
    "backlash:joint=1,gap=0.001",
    "transmission_error:joint=2,amplitude=5e-4,order=8",
)


def test_of_takes_a_set_or_a_file(tmp_path):
    for name in parameter_sets():
        assert Plant.of(name).arm == load_parameters(name)
    with pytest.raises(ParameterError, match="no parameter set or file 'nobody'; expected"):
        Plant.of("nobody")


def test_suggested_effects_of_a_set_are_not_active():
    plant = Plant.of("corke_armstrong_1994")
    assert plant.arm.suggested_effects and plant.effects == () and plant.constants.active == 0


def test_torque_per_ampere_is_that_of_the_form():
    assert plant_of().torque_per_ampere == pytest.approx((62.55 * 0.2611, 107.81 * 0.2611, 53.63 * 0.2611))
    assert plant_of(torque_form="printed").torque_per_ampere == (0.2611,) * 3
    with pytest.raises(ParameterError, match="torque_form 'half'; expected physical or printed"):
        plant_of(torque_form="half")


def test_viscous_friction_is_read_from_its_effects():
    assert plant_of("viscous_friction:joint=3,coefficient=4").viscous_friction == (0.0, 0.0, 4.0)


def test_constants_are_floats_whatever_the_parameters_are():
    # a whole number among them would be compiled as another kernel
    arm = plant_of().arm
    motors = tuple(replace(m, resistance=2, inductance=1, inertia=1) for m in arm.motors)
    constants = Plant(replace(arm, motors=motors, gravity=10)).constants
    for numbers in (constants.body, constants.drive, constants.table):
        assert all(type(value) is float for value in numbers)


@pytest.mark.parametrize("torque_form", ["physical", "printed"])
@pytest.mark.parametrize("name", parameter_sets())
def test_model_file_loads_to_an_equal_plant(tmp_path, name, torque_form):
    plant = plant_of(*ALL_EFFECTS, name=name, torque_form=torque_form)
    dump_model(plant, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again == plant
    mine, theirs = plant.constants, again.constants
    assert bits(mine.body) == bits(theirs.body) and bits(mine.drive) == bits(theirs.drive)
    assert mine.active == theirs.active and bits(mine.table) == bits(theirs.table)
    dump_model(again, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "model.yaml").read_bytes()


def test_model_file_says_its_format_version_and_units():
    mapping = plant_of(*ALL_EFFECTS).to_mapping()
    assert mapping["format"] == MODEL_FORMAT
    assert mapping["version"] == puma_sim_core.__version__
    assert mapping["effects"][1] == {"name": "coulomb_friction", "joint": 2, "torque": {"value": 12.0, "unit": "N.m"}}
    assert parse_yaml(yaml_text(mapping), "text") == mapping


def test_a_model_may_name_a_set_and_write_bare_numbers():
    plant = Plant.from_mapping(
        {
            "format": MODEL_FORMAT,
            "parameters": "paul",
            "effects": [{"name": "coulomb_friction", "joint": 2, "torque": 12}],
        }
    )
    assert plant == plant_of("coulomb_friction:joint=2,torque=12", name="paul")
    assert Plant.from_mapping({"format": MODEL_FORMAT, "parameters": "bejczy"}) == plant_of()


def changed(**changes):
    mapping = plant_of("coulomb_friction:joint=2,torque=12").to_mapping()
    return {key: value for key, value in {**mapping, **changes}.items() if value is not ...}


def effect_entry(**changes):
    entry = {"name": "coulomb_friction", "joint": 2, "torque": {"value": 12.0, "unit": "N.m"}}
    return changed(effects=[{**entry, **changes}])


@pytest.mark.parametrize(
    "mapping, message",
    [
        (None, f"no model; expected a mapping with format: {MODEL_FORMAT}"),
        ([], "no model"),
        ({"parameters": "bejczy"}, "no model"),
        (changed(format="puma-sim model 9"), "format 'puma-sim model 9'; expected 'puma-sim model 1'"),
        (changed(colour="red"), "unknown key 'colour'; expected one of format, version"),
        (changed(parameters=...), "'parameters' is missing"),
        (changed(effects={"a": 1}), "effects: {'a': 1}; expected a list"),
        (changed(torque_form="half"), "torque_form 'half'; expected physical or printed"),
        (changed(effects=["coulomb_friction"]), "effects: 'coulomb_friction'; expected {name: ..."),
        (effect_entry(name="magic"), "unknown effect 'magic'; expected one of"),
        (effect_entry(name=["coulomb_friction"]), "unknown effect"),
        (effect_entry(joint=4), "effect coulomb_friction: joint 4; expected joint=1, 2 or 3"),
        (effect_entry(joint=True), "joint True; expected joint=1, 2 or 3"),
        (
            effect_entry(torque={"value": 12.0, "unit": "kN.m"}),
            "effect coulomb_friction: torque: .*kN.m.*; expected {value: ..., unit: N.m}",
        ),
        (effect_entry(torque={"value": 12.0}), "torque: .*; expected {value: ..., unit: N.m}"),
        (effect_entry(torque={"value": "12", "unit": "N.m"}), "torque='12'; expected a number in N.m"),
        (effect_entry(torque={"value": float("nan"), "unit": "N.m"}), "torque=nan; expected 0 to 500"),
        (effect_entry(torqe=3), "unknown parameter 'torqe'"),
    ],
)
def test_a_model_that_cannot_be_rebuilt_is_named(mapping, message):
    with pytest.raises(ModelError, match=message) as caught:
        Plant.from_mapping(mapping, "model.yaml")
    assert str(caught.value).startswith("model.yaml")


def test_a_wrong_number_in_a_model_is_named_with_file_and_key(tmp_path):
    mapping = plant_of().to_mapping()
    mapping["parameters"]["motors"]["joint2"]["resistance"]["unit"] = "kohm"
    with pytest.raises(
        ParameterError, match="m.yaml: parameters: motors.joint2.resistance.unit: unit 'kohm'; expected ohm"
    ):
        Plant.from_mapping(mapping, "m.yaml")


def test_a_model_file_that_cannot_be_read_or_written_is_named(tmp_path):
    with pytest.raises(ModelError, match="nowhere.yaml: cannot be read"):
        load_model(tmp_path / "nowhere.yaml")
    (tmp_path / "broken.yaml").write_text("effects: [\n")
    with pytest.raises(ModelError, match="broken.yaml"):
        load_model(tmp_path / "broken.yaml")
    with pytest.raises(ModelError, match="cannot be written"):
        dump_model(plant_of(), tmp_path / "missing" / "model.yaml")
    assert not (tmp_path / "missing").exists()


def test_effects_act_whatever_their_order():
    def run(effects):
        simulator = Simulator(plant_of(*effects))
        simulator.reset((0.1, -1.2, 1.0))
        simulator.step((8.0, -9.0, 7.0), 0.5)
        return bits(simulator.state)

    assert run(ALL_EFFECTS) == run(ALL_EFFECTS[::-1])


def test_every_kind_of_effect_stands_in_the_model_file_of_these_tests():
    kinds = {effect.kind for effect in plant_of(*ALL_EFFECTS).effects}
    assert {kind.first for kind in kinds} == {kind.first for kind in KINDS.values()}
    assert all(isinstance(effect, Effect) for effect in plant_of(*ALL_EFFECTS).effects)
    assert np.isfinite(plant_of(*ALL_EFFECTS).constants.body).all()
