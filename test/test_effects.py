# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Effects as definitions: their registry, their text and file forms, and their errors."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path

import numpy as np
import pytest
from arm_reference import bits, plant_of, smooth_voltages
from hypothesis import given
from hypothesis import strategies as st

from puma_sim_core.effects import KINDS, Effect, base, parse_effect
from puma_sim_core.effects.base import Stage
from puma_sim_core.effects.registry import WIDTH, active_stages, pack, slot
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator

#: the effects that the issues ask for
PROMISED = {
    "viscous_friction",
    "coulomb_friction",
    "asymmetric_coulomb_friction",
    "stribeck_friction",
    "presliding_friction",
    "voltage_saturation",
    "current_limit",
    "payload",
    "soft_stop",
    "quadratic_friction",
    "load_dependent_friction",
    "position_dependent_friction",
    "torque_ripple",
    "transmission_error",
    "backlash",
    "joint_elasticity",
    "joint_spring",
    "base_tilt",
    "resistance_drift",
    "friction_warm_up",
    "voltage_dead_band",
    "voltage_offset",
    "input_delay",
    "sensor_lag",
    "encoder_offset",
    "sensor_nonlinearity",
    "supply_droop",
    "impulse",
}
every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))


def placed(kind, values, joint=2):
    return Effect(kind, joint if kind.per_joint else None, values)


def in_bounds(p):
    return st.floats(p.low, p.high)


@st.composite
def effects(draw):
    """Any effect with all its values, within bounds."""
    kind = KINDS[draw(st.sampled_from(sorted(KINDS)))]
    values = {p.name: draw(in_bounds(p)) for p in kind.parameters}
    if kind.name == "soft_stop":
        low, high = sorted((values["lower"], values["upper"]))
        values.update(lower=low, upper=high if low < high else low + 1.0)
        if values["upper"] > 10.0:
            values.update(lower=-1.0, upper=1.0)
    if kind.name == "sensor_nonlinearity":
        values["amplitude"] = min(values["amplitude"], values["period"] / 7.0)
    return placed(kind, values, draw(st.integers(1, 3)))


# --------------------------------------------------------------------------------- definitions


def test_all_promised_effects_are_registered():
    assert set(KINDS) >= PROMISED


@every_kind
def test_a_kind_says_what_it_is(kind):
    assert kind.name.isidentifier() and KINDS[kind.name] is kind
    assert kind.acts in (base.VOLTAGE, base.CURRENT, base.TORQUE, base.TRANSMISSION, base.LOAD, base.SENSING)
    assert kind.equation and kind.sentence.endswith(".")
    assert kind.parameters
    assert (kind.load is not None) == (kind.acts == base.LOAD)
    for p in kind.parameters:
        assert p.name.isidentifier() and p.name != "joint" and p.unit and p.meaning
        assert p.low < p.high and math.isfinite(p.low) and math.isfinite(p.high)
        assert p.default is None or p.low <= p.default <= p.high
        assert not math.isnan(p.neutral)


@every_kind
def test_a_kind_goes_to_another_process_and_is_the_same_there(kind):
    assert pickle.loads(pickle.dumps(kind)) is kind and copy.deepcopy(kind) is kind


def test_each_file_is_one_effect_of_its_name():
    folder = Path(base.__file__).parent
    helpers = {"__init__", "base", "registry", "relations", "screening"}
    assert {path.stem for path in folder.glob("*.py")} - helpers == {kind.first for kind in KINDS.values()}


def test_slots_of_the_table_do_not_overlap():
    taken = [slot(kind) + n for kind in KINDS.values() for n in range(len(kind.parameters))]
    assert sorted(taken) == list(range(WIDTH))


def test_stages_are_different_bits():
    stages = [stage.value for stage in Stage if stage]
    assert Stage.ALWAYS == 0 and sum(stages) == np.bitwise_or.reduce(stages)
    assert all(bin(stage).count("1") == 1 for stage in stages)


@given(effects())
def test_an_effect_takes_its_own_places_in_the_table(effect):
    neutral, table = pack([]), pack([effect])
    joints = (0, 1, 2) if effect.joint is None else (effect.joint - 1,)
    for j in range(3):
        for kind in KINDS.values():
            at = j * WIDTH + slot(kind)
            own = kind is effect.kind and j in joints
            expected = list(effect.values.values()) if own else [p.neutral for p in kind.parameters]
            assert table[at : at + len(expected)] == expected
            assert own or table[at : at + len(expected)] == neutral[at : at + len(expected)]
    assert active_stages([effect]) == effect.kind.stage


def test_a_bristle_takes_over_the_stick_and_slip_of_its_joint_only():
    coulomb = parse_effect("coulomb_friction:joint=1,torque=5")
    bristle = parse_effect("presliding_friction:joint=1")
    assert active_stages([coulomb, bristle]) == Stage.BRISTLE
    assert active_stages([coulomb, parse_effect("presliding_friction:joint=2")]) == Stage.DRY | Stage.BRISTLE


# ------------------------------------------------------------------------- an effect that is off


def test_a_plant_without_effects_enters_no_optional_stage():
    assert plant_of().constants.active == 0
    assert (
        plant_of(
            "viscous_friction:joint=1,coefficient=2", "voltage_saturation:joint=2", "payload:mass=1"
        ).constants.active
        == 0
    )


NEUTRAL = {
    "viscous_friction": "coefficient=0",
    "coulomb_friction": "torque=0",
    "asymmetric_coulomb_friction": "positive=0,negative=0",
    "stribeck_friction": "torque=0",
    "presliding_friction": "torque=0",
    "voltage_saturation": "voltage=1000",
    "current_limit": "current=1000",
    "payload": "mass=0",
    "soft_stop": "lower=-10,upper=10,stiffness=0,damping=0",
    "quadratic_friction": "coefficient=0",
    "load_dependent_friction": "coefficient=0",
    "position_dependent_friction": "torque=0,amplitude=0,angle=1",
    "torque_ripple": "amplitude=0,order=2",
    "transmission_error": "amplitude=0",
    "backlash": "gap=0",
    "joint_spring": "stiffness=0,angle=1",
    "base_tilt": "x=0,y=0",
    "resistance_drift": "share=0,time_constant=9",
    "friction_warm_up": "share=0,time_constant=9",
    "voltage_dead_band": "voltage=0",
    "voltage_offset": "voltage=0",
    "input_delay": "time=0",
    "sensor_lag": "time_constant=0",
    "encoder_offset": "angle=0",
    "sensor_nonlinearity": "amplitude=0,period=1",
    "supply_droop": "coefficient=0",
    "impulse": "torque=0,time=1,width=0.1",
}


def run(plant):
    time, volts = smooth_voltages((6.0, 9.0, 5.0), 2.0)
    simulator = Simulator(plant)
    simulator.reset((0.1, -1.2, 1.0))
    out = simulator.run(time, volts)
    assert (np.diff(np.sign(out.velocity[1:]), axis=0) != 0).any(axis=0).all()
    return bits(np.hstack([out.position, out.velocity, out.current]))


def test_every_kind_but_the_elastic_drive_can_vanish():
    assert set(NEUTRAL) == {kind.first for kind in KINDS.values()} - {"joint_elasticity"}


@pytest.mark.parametrize("name", NEUTRAL)
def test_an_effect_with_neutral_values_changes_no_bit(name):
    kind = KINDS[name]
    joints = [f"joint={j}," for j in (1, 2, 3)] if kind.per_joint else [""]
    neutral = [f"{kind.name}:{joint}{NEUTRAL[kind.name]}" for joint in joints]
    assert run(plant_of(*neutral)) == run(plant_of())


def test_a_sticking_joint_is_a_held_joint_and_no_event_for_the_others():
    # joints 2 and 3 reverse; they have nothing to stick with, so no step is divided there
    time, volts = smooth_voltages((6.0, 9.0, 5.0), 2.0)
    found = []
    for effects, constraint in ((["coulomb_friction:joint=1,torque=500"], Constraint()), ([], Constraint("hold"))):
        simulator = Simulator(plant_of(*effects), constraints=(constraint, Constraint(), Constraint()))
        simulator.reset((0.1, -1.2, 1.0))
        found.append(simulator.run(time, volts))
    assert (np.diff(np.sign(found[0].velocity[1:, 1:]), axis=0) != 0).any(axis=0).all()
    assert bits(found[0].position) == bits(found[1].position)


# ------------------------------------------------------------------------------------ text forms


@given(effects())
def test_text_form_keeps_every_digit(effect):
    again = parse_effect(str(effect))
    assert again == effect and hash(again) == hash(effect)
    assert bits(list(again.values.values())) == bits(list(effect.values.values()))


@given(effects())
def test_model_form_keeps_every_digit(effect):
    plant = Plant(plant_of().arm, (effect,))
    assert Plant.from_mapping(plant.to_mapping()).effects == plant.effects


def test_values_left_out_are_defaults_or_come_from_the_arm():
    assert parse_effect("stribeck_friction:joint=1,torque=3").values["velocity"] == 0.05
    plant = plant_of("soft_stop:joint=2", "payload:mass=2")
    stop, payload = plant.effects
    assert (stop.values["lower"], stop.values["upper"]) == plant.arm.joint_ranges[1]
    assert payload.values["z"] == plant.arm.d4
    assert parse_effect(" coulomb_friction: joint = 2 , torque = 12 ") == parse_effect(
        "coulomb_friction:joint=2,torque=12"
    )


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "unknown effect ''; expected one of those of `puma-sim list`"),
        ("magic:joint=1", "effect 'magic:joint=1': unknown effect 'magic'"),
        (
            "coulomb_friction:joint=1,torqe=3",
            "effect coulomb_friction: unknown parameter 'torqe'; expected one of torque",
        ),
        (
            "coulomb_friction:joint=1",
            r"effect coulomb_friction: 'torque' is missing; expected torque=VALUE in N.m \(Fc, at the",
        ),
        ("coulomb_friction:torque=3", "coulomb_friction: no joint; expected joint=1, 2 or 3"),
        ("coulomb_friction:joint=4,torque=3", "coulomb_friction: joint 4; expected joint=1, 2 or 3"),
        ("coulomb_friction:joint=0,torque=3", "joint 0; expected joint=1, 2 or 3"),
        ("coulomb_friction:joint=1.5,torque=3", "joint=1.5; expected joint=1, 2 or 3"),
        ("coulomb_friction:joint=two,torque=3", "joint=two; expected joint=1, 2 or 3"),
        ("payload:joint=1,mass=3", "payload: joint 1; expected no joint: it acts on the whole arm"),
        ("coulomb_friction:joint=1,torque=-1", "torque=-1; expected 0 to 500 N.m"),
        ("coulomb_friction:joint=1,torque=501", "torque=501; expected 0 to 500 N.m"),
        ("coulomb_friction:joint=1,torque=nan", "torque=nan; expected 0 to 500 N.m"),
        ("coulomb_friction:joint=1,torque=inf", "torque=inf; expected 0 to 500 N.m"),
        ("coulomb_friction:joint=1,torque=3,torque=4", "'torque' is given twice; expected each once"),
        ("coulomb_friction:joint=1,joint=1,torque=4", "'joint' is given twice; expected each once"),
        ("coulomb_friction:joint=1,torque=x", "torque=x; expected a number"),
        ("coulomb_friction:joint=1,torque", "'torque'; expected key=value"),
        ("coulomb_friction:joint=1,torque=", "'torque='; expected key=value"),
        ("soft_stop:joint=1,lower=2,upper=1", "lower=2, upper=1.*; expected lower below upper"),
    ],
)
def test_an_effect_that_cannot_be_used_is_named(text, message):
    with pytest.raises(ParameterError, match=message):
        parse_effect(text)


@every_kind
def test_values_outside_the_bounds_are_refused(kind):
    inside = {p.name: p.default if p.default is not None else (p.low + p.high) / 2 for p in kind.parameters}
    if kind.name == "soft_stop":
        inside.update(lower=-1.0, upper=1.0)
    if kind.name == "sensor_nonlinearity":
        inside.update(amplitude=0.001)
    placed(kind, inside)
    for p in kind.parameters:
        for value in (
            math.nextafter(p.low, -math.inf),
            math.nextafter(p.high, math.inf),
            math.nan,
            math.inf,
            "1",
            True,
            None if p.default is None and not p.from_arm else [1],
        ):
            message = rf"effect {kind.name}: .*{p.name}.*; expected"
            with pytest.raises(ParameterError, match=message):
                placed(kind, {**inside, p.name: value})


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_volts_and_amperes_may_be_in_another_unit(factor):
    # a drive may have its command in millivolts: what machines have must then be legal a thousand times larger
    sizes = [(kind, p) for kind in KINDS.values() for p in kind.parameters if p.unit in ("V", "A") and p.plausible]
    assert {kind.name for kind, _ in sizes} >= {
        "voltage_saturation",
        "voltage_offset",
        "voltage_dead_band",
        "current_limit",
    }
    for kind, p in sizes:
        for size in p.plausible:
            assert p.low < factor * size < p.high, f"{kind.name}.{p.name}"


@pytest.mark.parametrize("joint", [True, 1.0, "1", None, 0, 4])
def test_a_joint_is_a_whole_number_from_one_to_three(joint):
    with pytest.raises(ParameterError, match="expected joint=1, 2 or 3"):
        Effect(KINDS["coulomb_friction"], joint, {"torque": 1.0})


def test_the_same_kind_twice_on_a_joint_is_refused():
    twice = ["coulomb_friction:joint=2,torque=1", "coulomb_friction:joint=2,torque=2"]
    with pytest.raises(ParameterError, match="coulomb_friction stands twice on joint 2"):
        plant_of(*twice)
    with pytest.raises(ParameterError, match="payload stands twice on the arm"):
        plant_of("payload:mass=1", "payload:mass=2")
    plant_of(twice[0], twice[1].replace("joint=2", "joint=3"))


def test_a_stop_that_meets_an_arm_with_another_range_is_checked_there():
    with pytest.raises(ParameterError, match="lower below upper"):
        plant_of("soft_stop:joint=3,lower=9")
