# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The next experiment: excitations keep to limits, tell effects apart, and say when none can."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from puma_sim_core.cli import main, parser
from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify import explain
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.experiment.design import design, suspects_of
from puma_sim_core.identify.experiment.excitation import Builder, Limits, voltages
from puma_sim_core.identify.experiment.next_experiment import label, next_experiment
from puma_sim_core.identify.experiment.separation import Judge, Parameters, simulate
from puma_sim_core.identify.result import Hypothesis
from puma_sim_core.identify.screening.evidence import screen
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.screening.search import Chosen, Search
from puma_sim_core.identify.settings import EXPERIMENT, SELECTION
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.model_file import dump_model
from puma_sim_core.recording.recording import read_csv
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

MACHINES = {name: load_mechanism(name) for name in ("puma560", "pendulum", "slide")}
#: what each machine is asked for here
ASKED = {
    "puma560": "load_dependent_friction@2,position_dependent_friction@2",
    "pendulum": "stribeck_friction,coulomb_friction",
    "slide": "coulomb_friction,voltage_offset",
}


def designed(name, separate, **options):
    """A short search."""
    machine = MACHINES[name]
    return design(machine, suspects_of(separate.split(","), machine), **{"motions": 16, "seconds": 6.0, **options})


@pytest.fixture(scope="module")
def designs():
    return {name: designed(name, separate) for name, separate in ASKED.items()}


@pytest.fixture
def quick(monkeypatch):
    """The command's search with few motions."""
    fewer = replace(EXPERIMENT, design_motions=14)
    monkeypatch.setattr("puma_sim_core.identify.experiment.design.EXPERIMENT", fewer)


def written(tmp_path, *arguments, name="volts.csv"):
    """Bytes of what the command writes."""
    path = tmp_path / name
    assert main(["excite", "--force", "--out", str(path), "--seconds", "3", *arguments]) == 0
    return path.read_bytes()


# ------------------------------------------------------------------------------------ the motion


@pytest.mark.parametrize("seed", range(4))
def test_velocities_and_accelerations_are_those_of_the_positions(seed):
    machine = MACHINES["puma560"]
    builder = Builder(machine, Limits.of(machine), 8.0)
    rng = np.random.default_rng(seed)
    motion = builder.changed(builder.random(rng, frozenset({0, 1, 2})), rng)
    time, h = np.linspace(0.1, 7.9, 4000), 1e-5
    before, now, after = (motion.at(time + shift) for shift in (-h, 0.0, h))
    for n in (0, 1):
        slope = (after[n] - before[n]) / (2.0 * h)
        assert np.abs(slope - now[n + 1]).max() < 1e-5 * np.abs(now[n + 1]).max()
    q, qd, qdd = motion.at(np.array([0.0, 0.1, 7.9, 8.0]))
    assert np.array_equal(q, np.tile(motion.centre, (4, 1))) and not qd.any() and not qdd.any()


@pytest.mark.parametrize("name", MACHINES)
def test_motions_keep_to_ranges_speeds_and_voltages(name):
    machine = MACHINES[name]
    limits = replace(Limits.of(machine), velocity=0.2 * Limits.of(machine).velocity)
    builder, rng = Builder(machine, limits, 8.0), np.random.default_rng(5)
    time = np.linspace(0.0, 8.0, 8001)
    low, high = np.array(machine.ranges).T
    for _ in range(8):
        motion = builder.changed(builder.random(rng, frozenset({0})), rng)
        q, qd, qdd = motion.at(time)
        assert (q > low + 0.05 * (high - low)).all() and (q < high - 0.05 * (high - low)).all()
        assert (np.abs(qd) <= 1.01 * limits.velocity).all()
        assert (np.abs(machine.model_voltage(machine.start, q, qd, qdd)) <= limits.voltage).all()


@pytest.mark.parametrize("name", MACHINES)
def test_voltages_lead_the_model_along_the_motion(name, designs):
    found, machine = designs[name], MACHINES[name]
    position = simulate(machine.plant(), found.motion, found.time, found.voltage)
    span = np.ptp(machine.ranges, axis=1)
    assert (np.abs(position - found.setpoint).max(axis=0) < 0.01 * span).all()


@pytest.mark.parametrize("name", MACHINES)
def test_machines_that_are_not_the_model_stay_within_their_ranges(name, designs):
    found, machine = designs[name], MACHINES[name]
    low, high = np.array(machine.ranges).T
    rng = np.random.default_rng(77)
    usual = [(), *Judge(Builder(machine, Limits.of(machine), 6.0), suspects_of(ASKED[name].split(","), machine)).usual]
    assert (np.abs(found.voltage) <= Limits.of(machine).voltage).all()
    for n in range(9):
        theta = machine.start * (1.0 + rng.uniform(-0.08, 0.08, len(machine.start)))
        position = simulate(machine.plant(theta, usual[n % 3]), found.motion, found.time, found.voltage)
        assert (position > low).all() and (position < high).all()


def test_voltages_of_a_model_with_effects_make_up_for_them():
    machine = MACHINES["puma560"]
    dry = machine.of_plant(
        machine.plant(
            None,
            [parse_effect("coulomb_friction:joint=1,torque=15"), parse_effect("voltage_dead_band:joint=2,voltage=0.6")],
        )
    )
    motion = Builder(machine, Limits.of(machine), 6.0).plain()
    time = np.arange(int(6.0 / SERVO_PERIOD)) * SERVO_PERIOD
    noise = np.full(3, 1e-3)
    plan = motion.at(time)[0]
    blind, aware = (
        np.abs(simulate(dry.plant(), motion, time, voltages(m, motion, time, noise)) - plan).max(axis=0)[:2]
        for m in (machine, dry)
    )
    assert (aware < 0.25 * blind).all()


# ---------------------------------------------------------------------------------- the criterion


def test_what_is_left_of_an_effect_is_that_of_least_squares():
    """Against a dense least squares of the parameters, with their priors as rows, and of B."""
    machine = MACHINES["puma560"]
    builder = Builder(machine, Limits.of(machine), 6.0)
    judge = Judge(builder, suspects_of(["voltage_offset@2", "joint_spring@2"], machine))
    motion = builder.random(np.random.default_rng(3), frozenset({1}))
    signals = judge.planned(motion)
    base = Parameters(machine, signals)
    (one,), (other,) = (
        [(c, X) for c, X in zip(cs, base.reduced(cs))]
        for cs in (s.kind.screening.candidates(signals, s.joint - 1) for s in judge.suspects)
    )
    p = base.N.shape[1]
    for (candidate, X), against, n in ((one, other, 0), (other, one, 1)):
        half = 0.0
        root = np.vstack([candidate.mean, np.diag(candidate.deviation)])
        design_matrix = np.block([[base.N, against[1]], [np.eye(p), np.zeros((p, against[1].shape[1]))]])
        for coefficients in root:
            target = np.r_[X @ coefficients, np.zeros(p)]
            fit = np.linalg.lstsq(design_matrix, target, rcond=None)[0]
            half += 0.5 * float(((target - design_matrix @ fit) ** 2).sum())
        assert judge.on_plan(motion)[n].nats == pytest.approx(half, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("seed", (1, 2, 3))
def test_it_is_better_than_a_plain_motion(seed):
    found = designed("pendulum", "stribeck_friction,presliding_friction", seed=seed, motions=24)
    assert found.nats > 3.0 * found.plain and found.nats > SELECTION.least_gain


def test_it_is_better_than_a_plain_motion_on_the_arm(designs):
    assert designs["puma560"].nats > designs["puma560"].plain
    assert designs["pendulum"].nats > 1.5 * designs["pendulum"].plain


def test_several_are_told_apart_each_from_each():
    machine = MACHINES["pendulum"]
    suspects = suspects_of(["coulomb_friction", "voltage_dead_band", "voltage_offset"], machine)
    builder = Builder(machine, Limits.of(machine), 6.0)
    judge = Judge(builder, suspects)
    assert len(judge.directions) == 6
    # the distances are those of the pairs alone
    motion = builder.plain()
    together = dict(zip(judge.directions, judge.on_plan(motion)))
    for n, m in ((0, 1), (1, 2)):
        pair = Judge(builder, (suspects[n], suspects[m]))
        assert [d.nats for d in pair.on_plan(motion)] == pytest.approx([together[n, m].nats, together[m, n].nats])
    found = design(machine, suspects, motions=6, seconds=6.0)
    assert found.one_way is None and "voltage_dead_band@1 and voltage_offset@1" in found.sentence


def test_a_special_case_is_told_one_way_only(designs):
    assert designs["pendulum"].one_way == "stribeck_friction@1"
    assert "special case" in designs["pendulum"].sentence
    # an offset is no special case of friction, nor the other way round
    assert designs["slide"].one_way is None and designs["slide"].nats > SELECTION.least_gain


def test_exact_ties_are_reported_as_impossible():
    with pytest.raises(ParameterError, match="exact tie with parameters of slide"):
        designed("slide", "payload")
    with pytest.raises(ParameterError, match="no motion shows encoder_offset@1"):
        designed("slide", "encoder_offset,coulomb_friction")
    # without gravity two springs on one joint differ in nothing: as an effect and its own copy
    twin = replace(KINDS["joint_spring"], name="other_spring")
    machine = MACHINES["slide"]
    (one,) = suspects_of(["joint_spring"], machine)
    with pytest.raises(ParameterError, match="joint_spring@1 and other_spring@1 are an exact tie"):
        design(machine, (one, replace(one, kind=twin)), seconds=4.0, motions=8)


# ------------------------------------------------------------------------------------ the command


def test_the_same_arguments_write_the_same_bytes(tmp_path, quick):
    arguments = ("--plant", "pendulum", "--separate", "joint_spring", "--max-voltage", "3")
    first = written(tmp_path, *arguments)
    assert written(tmp_path, *arguments, name="again.csv") == first
    assert written(tmp_path, *arguments, "--seed", "8", name="other.csv") != first


def test_simulate_takes_the_file_and_the_pose(tmp_path, capsys, quick):
    path, plan, out = (str(tmp_path / name) for name in ("volts.csv", "plan.csv", "run.csv"))
    model = tmp_path / "model.yaml"
    dump_model(MACHINES["pendulum"].plant(), model)
    assert (
        main(
            [
                "excite",
                "--plant",
                "pendulum",
                "--separate",
                "joint_spring",
                "--seconds",
                "3",
                "--rate",
                "500",
                "--out",
                path,
                "--setpoints",
                plan,
            ]
        )
        == 0
    )
    told = capsys.readouterr().err
    lines = Path(path).read_text().splitlines()
    head = [line[2:] for line in lines if line.startswith("# ")]
    assert head[0] == "puma-sim excite --separate joint_spring@1" and head[1] in told
    start = head[-1].split()[-2]
    assert main(["simulate", path, "--model", str(model), "--initial", start, "--out", out]) == 0
    run = read_csv(out, ("voltage", "position"), ("velocity", "current"), joints=1)
    assert len(run.time) == 1501 and run.time[-1] == pytest.approx(3.0)
    wanted = read_csv(plan, ("setpoint",), joints=1).setpoint
    assert np.abs(run.position - wanted).max() < 0.02 and np.ptp(wanted) > 0.1


@pytest.mark.parametrize(
    "arguments, expected",
    [
        (["--separate", "viscous_friction@1"], "back-EMF"),
        (["--separate", "impulse@1"], "cannot be brought about"),
        (["--separate", "stiction@1"], "unknown effect 'stiction'"),
        (["--separate", "coulomb_friction"], "coulomb_friction@1 to coulomb_friction@3"),
        (["--separate", "coulomb_friction", "--joint", "4"], "joint 4"),
        (["--separate", "coulomb_friction@two"], "joint 'two'"),
        (["--separate", "payload@3"], "the whole arm"),
        (["--separate", "coulomb_friction@2,coulomb_friction", "--joint", "2"], "twice"),
        (["--separate", "payload,base_tilt,input_delay,supply_droop,sensor_lag@1"], "up to 4"),
        (["--separate", ""], "unknown effect ''"),
        (["--plant", "pendulum", "--separate", "base_tilt"], "no meaning on pendulum"),
        (["--separate", "payload", "--seconds", "1"], "2 to 600 s"),
        (["--separate", "payload", "--rate", "50"], "100 at least"),
        (["--separate", "payload", "--seconds", "600", "--rate", "1e5"], "300000 rows"),
        (["--separate", "payload", "--max-voltage", "0"], "above 0"),
        (["--separate", "payload", "--plant", "puma561"], "puma561"),
    ],
)
def test_what_cannot_be_excited_is_one_clear_line(arguments, expected, tmp_path, capsys):
    out = tmp_path / "volts.csv"
    assert main(["excite", "--out", str(out), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and expected in error and "expected" in error
    assert not out.exists()


# ----------------------------------------------------------------------------- what to record next


def test_the_first_tie_is_to_be_broken():
    machine = MACHINES["puma560"]
    ties = [
        (Hypothesis("coulomb_friction", 2), Hypothesis("asymmetric_coulomb_friction", 2)),
        (Hypothesis("impulse", 2), Hypothesis("backlash", 2)),
        (Hypothesis("coulomb_friction", 2), Hypothesis("voltage_dead_band", 2)),
    ]
    found = next_experiment(machine, ties, [Hypothesis("payload", None)], "monday.csv", parameters="my set.yaml")
    # the simpler of two that contain each other stands, and nobody can ask for a blow
    assert found.separate == ties[2]
    assert "monday.csv" in found.sentence and "gravity drives the joint" in found.sentence
    for each in found.separate:
        needed = KINDS[each.name].screening.excitation
        assert needed[1:] in found.sentence
    more = next_experiment(
        machine, [(*ties[2], Hypothesis("voltage_offset", 2), Hypothesis("impulse", 2))], [], "x.csv"
    )
    assert more.separate == (*ties[2], Hypothesis("voltage_offset", 2))
    words = shlex.split(found.command)
    options = parser().parse_args(words[1:])
    assert words[0] == "puma-sim" and options.parameters == "my set.yaml"
    assert [s.label for s in suspects_of(options.separate.split(","), machine)] == list(map(label, ties[2]))


def test_else_what_the_log_did_not_excite():
    machine = MACHINES["pendulum"]
    unseen = [Hypothesis("payload", None), Hypothesis("base_tilt", None), Hypothesis("torque_ripple", 1)]
    found = next_experiment(machine, [], unseen, "log.csv")
    assert found.separate == (Hypothesis("torque_ripple", 1),)
    assert next_experiment(machine, [], unseen[:2], "log.csv").separate == (unseen[0],)
    assert next_experiment(machine, [], unseen[1:2], "log.csv") is None
    # where joint 1 of the arm has its zero makes no difference
    unseen = [Hypothesis("encoder_offset", 1), Hypothesis("encoder_offset", 2)]
    assert next_experiment(MACHINES["puma560"], [], unseen, "log.csv").separate == (unseen[1],)


def recorded(machine, motion, *effects, seed=4):
    """A log of a machine with wrong parameters, noise of the voltage and counts of the encoder."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(motion.seconds / SERVO_PERIOD)) * SERVO_PERIOD
    volts = voltages(machine, motion, time, np.full(machine.joints, 1e-3))
    theta = machine.start * (1.0 + rng.uniform(-0.05, 0.05, len(machine.start)))
    plant = machine.plant(theta, [parse_effect(text) for text in effects])
    position = simulate(plant, motion, time, volts + 0.02 * rng.normal(size=volts.shape))
    count = 2.0 * np.pi / 65536.0
    return Log("log", time, volts, np.round(position / count) * count)


def gains(machine, log, names):
    """Gain of log evidence [nat] of each effect, in the noise that the best of them leaves."""
    search = Search(Problem(sample([log]), machine), {name: KINDS[name] for name in names})
    fit = search.retune(machine.start)
    bank = search.bank(fit.theta)
    for _ in range(2):
        best = max(screen(fit.base, fit.base.whiten(bank)), key=lambda s: s.gain)
        weights = search.settle(fit.linear, (Chosen(best.best.entry, bank.columns_of(best.best.entry)),)).weights
        fit = search.base(fit.linear, (), weights)
    return {s.name: s.gain for s in screen(fit.base, fit.base.whiten(bank))}


@pytest.mark.long
@pytest.mark.parametrize("truth", ("encoder_offset:joint=1,angle=0.03", "voltage_offset:joint=1,voltage=0.15"))
def test_a_tie_is_broken_by_the_excitation_for_it(truth):
    """A small slow sine cannot tell a sensor's offset from the amplifier's; what is written can."""
    machine, names = MACHINES["pendulum"], ("encoder_offset", "voltage_offset")
    (other,) = set(names) - {truth.partition(":")[0]}
    slow = Builder(machine, Limits.of(machine), 8.0).plain()
    slow = slow.shrunk(np.array([0.1]), slow.centre)
    poor = gains(machine, recorded(machine, slow, truth), names)
    assert min(poor.values()) > SELECTION.least_gain and abs(np.diff(list(poor.values()))[0]) < 8.0
    asked = next_experiment(machine, [tuple(Hypothesis(name, 1) for name in names)], (), "log.csv")
    options = parser().parse_args(shlex.split(asked.command)[1:])
    found = designed(options.plant, options.separate)
    good = gains(machine, recorded(machine, found.motion, truth), names)
    named = good[truth.partition(":")[0]]
    assert named - good[other] > max(8.0, 0.05 * named)


def measured(machine, truth, time, volts, start, seed):
    """A log of a machine with wrong parameters under voltages, with noise and counts."""
    rng = np.random.default_rng(seed)
    theta = machine.start * (1.0 + np.random.default_rng(4).uniform(-0.05, 0.05, len(machine.start)))
    simulator = Simulator(machine.plant(theta, [parse_effect(truth)]), max_step=1e-3)
    simulator.reset(start)
    position = simulator.run(time, volts + 0.02 * rng.normal(size=volts.shape)).position
    count = 2.0 * np.pi / 65536.0
    return Log("log", time, volts, np.round(position / count) * count)


def told(explanation):
    """(name, names it is tied with) of the only effect."""
    assert explanation.verdict == "NAMED"
    (effect,) = explanation.effects
    return effect.name, {tie.name for tie in effect.tied_with}


@pytest.mark.thorough
@pytest.mark.parametrize("truth", ("encoder_offset:joint=1,angle=0.03", "voltage_offset:joint=1,voltage=0.15"))
def test_the_log_of_what_is_written_breaks_the_tie_that_explain_reported(truth, tmp_path):
    """The whole way: a poor log, the command that its report gives, and the log of what that
    wrote, explained."""
    machine, name = MACHINES["pendulum"], truth.partition(":")[0]
    pair = {"encoder_offset", "voltage_offset"}
    motion = Builder(machine, Limits.of(machine), 8.0).plain()
    motion = motion.shrunk(np.array([0.1]), motion.centre)
    time = np.arange(0.0, 8.0, 1.0 / 400.0)
    volts = voltages(machine, motion, time, np.full(1, 1e-3))
    poor = measured(machine, truth, time, volts, tuple(motion.centre), 1)
    before = explain(poor, plant="pendulum")
    first, ties = told(before)
    assert first in pair and pair <= {first, *ties}

    asked = parser().parse_args(shlex.split(before.next_experiment.command)[1:])
    assert first + "@1" in asked.separate
    path = tmp_path / "volts.csv"
    assert (
        main(
            [
                "excite",
                "--plant",
                asked.plant,
                "--seconds",
                "8",
                "--rate",
                "400",
                "--separate",
                ",".join(f"{each}@1" for each in sorted(pair)),
                "--out",
                str(path),
            ]
        )
        == 0
    )
    (pose,) = (line.split()[-2] for line in path.read_text().splitlines() if line.startswith("# start"))
    run = read_csv(path, ("voltage",), joints=1)
    good = measured(machine, truth, run.time, run.voltage, (float(pose),), 2)
    for logs in (good, [poor, good]):
        found, ties = told(explain(logs, plant="pendulum"))
        assert found == name and not pair & ties
