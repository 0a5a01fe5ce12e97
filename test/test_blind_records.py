# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The blind records: their engine, their effects against the project's, and their plan."""

from __future__ import annotations

import ast
import json
import pickle
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.long
pytest.importorskip("numba")
mujoco = pytest.importorskip("mujoco")

from blind import arm_mujoco, arm_parameters, cases, drives, effects, faults, generate, records, size

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator

BLIND = Path(__file__).parent / "blind"
RECORDS = BLIND / "records"


def true_parameters(seed: int) -> arm_parameters.Parameters:
    return arm_parameters.wrong(np.random.default_rng(seed))


def projects_plant(p, *texts: str) -> Plant:
    """The project's own plant with the parameters of a blind one."""

    def column(j, *names):
        return tuple(float(p[name][j]) for name in names)

    arm = load_parameters("bejczy")
    links = tuple(
        replace(
            link,
            mass=float(p["m"][j]),
            centre=column(j, "x", "y", "z"),
            gyration_squared=column(j, "kxx", "kyy", "kzz"),
        )
        for j, link in enumerate(arm.links)
    )
    motors = tuple(
        replace(motor, resistance=R, inductance=L, back_emf=ke, torque_constant=kt, inertia=Ia)
        for j, motor in enumerate(arm.motors)
        for R, L, ke, kt, Ia in [column(j, "R", "L", "ke", "kt", "Ia")]
    )
    viscous = [f"viscous_friction:joint={j + 1},coefficient={float(p['H'][j])!r}" for j in range(3)]
    return Plant(replace(arm, links=links, motors=motors), tuple(map(parse_effect, (*viscous, *texts))))


def test_the_generator_imports_nothing_of_the_project():
    for path in BLIND.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else []
            )
            assert not any(name.startswith("puma_sim") for name in names), path.name


def test_closed_form_and_mujoco_are_one_arm():
    p = true_parameters(1)
    model, _ = arm_mujoco.model(p, arm_mujoco.Mechanics(), 1e-4)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    for q, qd, qdd in rng.uniform(-2.0, 2.0, (20, 3, 3)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        own = arm_parameters.motor_torque(q[None], qd[None], qdd[None], p)[0]
        np.testing.assert_allclose(data.qfrc_inverse, own, rtol=0.0, atol=1e-11)


def test_dry_friction_of_the_engine_holds_and_slips_sharply():
    p = true_parameters(3)
    model, _ = arm_mujoco.model(p, arm_mujoco.Mechanics(), 1e-4)
    model.opt.gravity[:] = 0.0
    model.dof_frictionloss[0] = 10.0
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = 9.9
    mujoco.mj_step(model, data, 5000)
    assert abs(data.qvel[0]) < 1e-6  # creep of 0.5 s below the level
    mujoco.mj_resetData(model, data)
    data.qfrc_applied[0] = 12.0
    mujoco.mj_step(model, data)
    moved = data.qacc.copy()
    # the same as without friction, with the level taken off
    model.dof_frictionloss[0] = 0.0
    mujoco.mj_resetData(model, data)
    data.qfrc_applied[0] = 2.0
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(moved, data.qacc, rtol=1e-3, atol=1e-9)


def quiet_run(name: str | None, seed: int, seconds: float, strength: float | None = None):
    """(rig, placed effect, run) of a plant without noise and quantisation."""
    kind = name or "nothing"
    recipe = replace(
        records.plan(kind, seed, 1)[0], period=1e-3, seconds=seconds, feedback=True, version=records.VERSION
    )
    rig = generate.Rig(recipe, seed, true_parameters(seed))
    rig.noise[:] = rig.torque_noise[:] = 0.0
    placed = []
    if name:
        effect, joint = effects.EFFECTS[name], recipe.effects[0][1]
        drawn = effects.scaled(
            effect,
            effect.draw(np.random.default_rng(seed), joint),
            min(strength or 1.5 * effect.start, effect.most(joint)),
        )
        peak = generate._peaks(rig)[joint] if joint is not None else None
        placed = [(name, joint, effects.derived(name, drawn, peak, seconds))]
    plant = generate._plant(placed, None)
    run = drives.simulate(
        rig.parameters,
        plant.mechanics,
        plant.table,
        plant.droop,
        plant.delay,
        rig.controller,
        rig.sampling,
        rig.noise,
        rig.torque_noise,
        quantised=False,
    )
    return rig, placed, run


def again_by_the_project(rig, placed, run) -> np.ndarray:
    """Positions (n, 3) of the project's simulator under the same voltages."""
    texts = []
    for name, joint, parameters in placed:
        parts = [] if joint is None else [f"joint={joint + 1}"]
        parts += [
            f"{key}={value!r}"
            for key, value in parameters.items()
            if abs(value) != effects.NO_STOP or key not in ("lower", "upper")
        ]
        parts += ["damping=0"] if name == "soft_stop" else []
        texts.append(f"{name}:{','.join(parts)}")
    p = rig.parameters
    start = run.motion[0].copy()  # of the motors, less what their sensors add
    for name, joint, parameters in placed:
        if name == "encoder_offset":
            start[joint] -= parameters["angle"]
        elif name == "sensor_nonlinearity":
            start[joint] = rig.controller.setpoint[0, joint]
    hold = arm_parameters.gravity(start[None], p)[0]
    simulator = Simulator(projects_plant(p, *texts))
    simulator.reset(tuple(map(float, start)), None, tuple(map(float, hold / (arm_parameters.GEAR * p["kt"]))))
    time = np.arange(len(run.commanded)) * rig.sampling.period
    return simulator.run(time, run.commanded).position


def test_without_effects_both_engines_move_alike():
    rig, placed, run = quiet_run(None, 2501, 3.0)
    assert np.ptp(run.motion, axis=0).min() > 0.05
    np.testing.assert_allclose(again_by_the_project(rig, placed, run), run.motion, rtol=0.0, atol=1e-5)


#: hysteresis of joints that stick makes no error grow; knocks of the teeth do, a little
_TOLERANCE = {"backlash": 5e-5}


@pytest.mark.parametrize("name", effects.EFFECTS)
def test_an_effect_of_the_table_acts_as_the_projects_effect_of_that_name(name, monkeypatch):
    """Two authors, one table: the same motion in both engines, and not without the effect. In motions of the first
    version, which the tolerances were made for."""
    monkeypatch.setattr(records, "VERSION", 1)
    rig, placed, run = quiet_run(name, 2510, 1.2)
    tolerance = _TOLERANCE.get(name, 1.5e-5)
    with_effect = np.abs(again_by_the_project(rig, placed, run) - run.motion).max()
    quiet = [] if name != "encoder_offset" else [(name, placed[0][1], {"angle": 0.0})]
    without = np.abs(again_by_the_project(rig, quiet, run) - run.motion).max()
    assert with_effect < tolerance
    assert without > 4.0 * tolerance


def test_a_plant_with_nothing_missing_has_no_size_and_friction_has_its_own():
    rig, _, _run = quiet_run(None, 2520, 3.0)
    noise = np.random.default_rng(1).normal(0.0, 0.05, rig.noise.shape)
    rig.noise[:] = noise
    plain = rig.sizes(rig.run(effects.Plant()))
    assert (plain.ratio < 0.02).all()
    found = []
    for level in (2.0, 4.0):
        plant = effects.Plant()
        plant.table[1, drives.COULOMB] = level
        sizes = rig.sizes(rig.run(plant))
        assert sizes.raw[1] > 100.0 * max(sizes.raw[0], sizes.raw[2])
        k = rig.parameters["R"][1] / (arm_parameters.GEAR[1] * rig.parameters["kt"][1])
        assert 0.6 * k * level < sizes.raw[1] < 1.05 * k * level  # less where it rests
        found.append(sizes.ratio[1])
    assert found[1] == pytest.approx(2.0 * found[0], rel=0.25)
    assert isinstance(plain, size.Sizes)


def test_a_committed_record_is_made_again_byte_for_byte(tmp_path):
    recipe = next(r for r in records.committed() if r.effects)
    path, answer = generate.make(recipe, tmp_path)
    assert path.read_bytes() == (RECORDS / path.name).read_bytes()
    answers = json.loads((RECORDS / "answers.json").read_text())
    answer.pop("seconds_to_make")
    assert json.loads(json.dumps(answer)) == answers[recipe.name]


def test_the_committed_set_is_small_and_complete():
    answers = json.loads((RECORDS / "answers.json").read_text())
    files = {path.stem for path in RECORDS.glob("*.csv")}
    assert files == set(answers) == {recipe.name for recipe in records.committed()}
    assert sum(path.stat().st_size for path in RECORDS.iterdir()) < 3_000_000
    kinds = Counter(
        "fault" if a["faults"] else "outside" if a["outside"] else len(a["effects"]) for a in answers.values()
    )
    assert min(kinds[kind] for kind in (0, 1, 2, "outside", "fault")) >= 2
    plain = [a for a in answers.values() if not a["faults"]]
    assert {a["feedback"] for a in plain} == {True, False}
    assert all(1000 <= a["seed"] < 1100 for a in answers.values())


def test_plans_are_deterministic_small_and_cover_every_name():
    for kind in records.KINDS:
        first, second = (records.plan(kind, 2000, 40) for _ in range(2))
        assert first == second
        assert len(pickle.dumps(first)) < 40_000
        assert len({recipe.name for recipe in first}) == 40
    names = Counter(r.effects[0][0] for r in records.plan("effect", 2000, len(effects.EFFECTS)))
    assert set(names.values()) == {1} and set(names) == set(effects.EFFECTS)
    for recipe in records.plan("pair", 2000, 40):
        (one, _), (other, _) = recipe.effects
        assert effects.EFFECTS[one].family != effects.EFFECTS[other].family
    springs = [
        recipe
        for recipe in records.plan("pair", 2000, 1000)
        if {name for name, _ in recipe.effects} == records.ONE_ANGLE
    ]
    assert springs and all(one[1] != other[1] for one, other in (r.effects for r in springs))


def test_each_version_of_the_generator_has_draws_of_its_own():
    recipe = records.plan("nothing", 2000, 1)[0]
    streams = [replace(recipe, version=version).random(3).random(4).tolist() for version in (1, 2)]
    assert streams[0] == np.random.default_rng([2000, 3]).random(4).tolist() != streams[1]
    assert recipe.version == records.VERSION and all(each.version == 1 for each in records.committed())


def test_cases_take_turns_and_have_what_they_need():
    found = records.plan("case", 2300, 3 * len(cases.CASES))
    assert [recipe.case for recipe in found[: len(cases.CASES)]] == list(cases.CASES)
    for recipe in found:
        case = cases.CASES[recipe.case]
        assert recipe.feedback and tuple(name for name, _ in recipe.effects) == case.effects
        assert not case.periods or recipe.period in case.periods
        assert set(case.draw) <= set(case.effects)


def test_limits_and_stops_are_drawn_relative_to_the_motion():
    rng, t = np.random.default_rng(5), np.linspace(0.0, 20.0, 5000)
    asked = cases.Demand(np.sin(t), 20.0 * np.sin(t), 3.0 * np.sin(t), 0.2 * np.cos(t), 1.5 * np.cos(t))
    shares, stiffness = [], []
    for _ in range(300):
        current = cases.CASES["current_limit_in_use"].draw["current_limit"](rng, 0, asked)["current"]
        volts = cases.CASES["voltage_limit_in_use"].draw["voltage_saturation"](rng, 0, asked)["voltage"]
        stop = cases.CASES["stop_met_in_part"].draw["soft_stop"](rng, 0, asked)
        assert current >= 1.1 * 0.2 * (1 - 1e-3) and volts >= 1.1 * 1.5 * (1 - 1e-3)
        shares += [np.mean(np.abs(asked.current) > current), np.mean(np.abs(asked.voltage) > volts)]
        past = np.mean((asked.position > stop["upper"]) | (asked.position < stop["lower"]))
        assert 0.02 < past < 0.61
        stiffness.append(stop["stiffness"])
    assert 0.015 < min(shares) < 0.05 and 0.4 < max(shares) < 0.51
    assert min(stiffness) < 50.0 and max(stiffness) > 8000.0


@pytest.mark.thorough
def test_a_limit_that_holds_its_load_in_no_motion_is_drawn_again(tmp_path, monkeypatch):
    tried = []
    in_range = generate.Rig.in_range
    monkeypatch.setattr(generate.Rig, "in_range", lambda rig, run: tried.append(rig) or in_range(rig, run))
    # 5.6 kg on the forearm, and a joint 2 that cannot carry it
    (recipe,) = [each for each in records.plan("case", 2400, 40, turn=2400) if each.seed == 2417]
    _, answer = generate.make(recipe, tmp_path)
    assert len(tried) > generate._MOTIONS and {e["name"] for e in answer["effects"]} == set(dict(recipe.effects))


def test_the_gain_of_an_oscillating_loop_is_about_the_critical_one():
    """The loop's own phase, evaluated on a grid: -180 degrees where its gain is between 1 / 0.9 and 1 / 1.5."""
    for seed, delay in ((1, 2e-3), (2, 4e-3), (3, 8e-3)):
        joint, gain = cases.oscillating_gain(np.random.default_rng(seed), delay, 1e-3)
        p = arm_parameters.nominal()
        emf = p["ke"][joint] * arm_parameters.GEAR[joint]
        mass = arm_parameters.inertia(np.array([[0.0, -np.pi / 2, np.pi / 2]]), p)[0, joint, joint] + p["Ia"][joint]
        tau = p["R"][joint] / (arm_parameters.GEAR[joint] * p["kt"][joint]) * mass / emf
        w = np.geomspace(1.0, 1e4, 200_001)
        loop = gain * np.exp(-1j * w * (delay + 0.5e-3)) / (emf * 1j * w * (1.0 + 1j * w * tau))
        crossing = np.argmax(np.unwrap(np.angle(loop)) < -np.pi)
        assert 0.899 < abs(loop[crossing]) < 1.501


@pytest.mark.parametrize("kind", faults.FAULTS)
def test_a_fault_is_where_the_answer_says(kind):
    n = 400
    time = np.arange(n) * 5e-3
    log = {"time": time}
    for j in (1, 2, 3):
        log[f"voltage{j}"] = 5.0 * np.sin(2.0 * time + j)
    for j in (1, 2, 3):
        log[f"position{j}"] = np.cos(1.5 * time + 2.0 * j)
    before = {name: x.copy() for name, x in log.items()}
    spoilt, found = faults.spoil(kind, log, np.random.default_rng(3))
    lines = [",".join(log)] + [",".join(f"{x:.6g}" for x in row) for row in zip(*log.values())]
    text, more = faults.spoil_text(kind, lines, np.random.default_rng(3))
    assert all((log[name] == before[name]).all() for name in log)  # the good log is left alone
    (fault, *_) = found + more
    assert fault["what"]
    if fault["channel"] is None:
        return
    assert fault["channel"] in log
    row = fault["row"]
    if more:
        assert text[row] != lines[row] and text[:row] == lines[:row]
    elif row is None:
        changed = np.abs(spoilt[fault["channel"]] - before[fault["channel"]]) > 1e-9
        assert changed.mean() > 0.9
    else:
        x, y = spoilt[fault["channel"]], before[fault["channel"]]
        good = row - 2 if kind == "reversed_time" else row - 1  # the row before came too early
        assert (x[:good] == y[:good]).all()
        assert row > len(x) or x[row - 1 : row + 1].tolist() != y[row - 1 : row + 1].tolist()
