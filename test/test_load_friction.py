# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Friction that grows with the torque that a gear transmits, against integrations by SciPy.

The oracle is one joint with its own events: it slides in a direction until it stops, and stands
until what pushes it exceeds mu |G + a (T - G)|, T what the motor gives at that moment.
"""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from arm_reference import bits, plant_of
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from screening_support import recorded, signals_of, torque_per_ampere

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.effects.base import Role
from puma_sim_core.identify.screening.known_effects import known_voltage
from puma_sim_core.plant.linkage.linkage_file import linkage_mapping, read_linkage
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.batch import InitialState, run_batch
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator

NAME = "load_dependent_friction"
WEIGHT, INERTIA, VISCOUS, KT, R = 0.49 * 9.81 * 0.1, 0.49 * 0.01 + 0.0019, 0.0066, 0.334, 3.29
DRIVES = {"voltage": {}, "inductance": {"inductance": 0.02}, "current": None}
HOLD = Constraint("hold")


def pendulum(drive, *effects):
    mapping = linkage_mapping(load_mechanism("pendulum").body)
    if drive == "current":
        mapping["drive"] = {
            "amplifier": "current",
            "gain": {"value": KT / R, "unit": "N.m/V", "known": True},
            "motor_inertia": mapping["drive"]["motor_inertia"],
            "viscous_friction": mapping["drive"]["viscous_friction"],
        }
    body = read_linkage({k: v for k, v in mapping.items() if k != "format"})
    return LinkagePlant.of(body, map(parse_effect, effects), DRIVES[drive])


class Oracle:
    """A pendulum with Coulomb friction and friction by load, integrated between its events."""

    def __init__(self, drive, coulomb, mu, a, q, drag=0.0):
        self.drive, self.coulomb, self.mu, self.a, self.drag = drive, coulomb, mu, a, drag
        self.q, self.w, self.i, self.direction = q, 0.0, 0.0, 0.0
        self.stops = self.starts = 0

    def current(self, w, i):
        if self.drive == "inductance":
            return i
        return self.volts / R if self.drive == "current" else (self.volts - KT * w) / R

    def motor(self, w, i):
        return (KT * self.current(w, i) if self.on else 0.0) - VISCOUS * w

    def level(self, torque, q):
        gravity = WEIGHT * np.sin(q)
        return self.coulomb + self.mu * abs(gravity + self.a * (torque - gravity))

    def slope(self, _, y):
        q, w, i = y
        rate = 0.0
        if self.drive == "inductance" and self.on:
            rate = (self.volts - R * i - KT * w) / 0.02
        if self.direction == 0.0:
            return [0.0, 0.0, rate]
        torque = self.motor(w, i)
        pushed = torque - WEIGHT * np.sin(q) - self.drag * w * abs(w)
        return [w, (pushed - self.direction * self.level(torque, q)) / INERTIA, rate]

    def excess(self, _, y):
        """What pushes the standing joint beyond its level."""
        torque = self.motor(0.0, y[2])
        return abs(torque - WEIGHT * np.sin(y[0])) - self.level(torque, y[0])

    def advance(self, volts, duration, on=True):
        self.volts, self.on = volts, on
        if not on:
            self.i = 0.0
        t = 0.0
        while t < duration * (1.0 - 1e-12):
            if self.w == 0.0:
                torque = self.motor(0.0, self.i)
                free = self.excess(0.0, (self.q, 0.0, self.i)) > 1e-12
                self.direction = np.sign(torque - WEIGHT * np.sin(self.q)) if free else 0.0
                self.starts += free
            event = self.excess if self.direction == 0.0 else (lambda _, y: y[1])
            if self.direction != 0.0 and self.w == 0.0:
                # away from rest before a return to it is looked for
                step = min(1e-6, duration - t)
                run = solve_ivp(self.slope, (0.0, step), (self.q, 0.0, self.i), rtol=1e-10, atol=1e-13)
                self.q, self.w, self.i = run.y[:, -1]
                t += step
                continue

            def stop(_, y):
                return event(_, y)

            stop.terminal = True
            run = solve_ivp(self.slope, (t, duration), (self.q, self.w, self.i), rtol=1e-10, atol=1e-13, events=stop)
            self.q, self.w, self.i = run.y[:, -1]
            t = run.t[-1]
            if run.status == 1:
                if self.direction != 0.0:
                    self.w, self.stops = 0.0, self.stops + 1
                elif t < duration:
                    # past the level by a hair, so that it starts
                    self.starts += 1
                    self.direction = np.sign(self.motor(0.0, self.i) - WEIGHT * np.sin(self.q))
                    step = min(1e-6, duration - t)
                    run = solve_ivp(self.slope, (0.0, step), (self.q, 0.0, self.i), rtol=1e-10, atol=1e-13)
                    self.q, self.w, self.i = run.y[:, -1]
                    self.w = self.w if self.w * self.direction > 0.0 else 1e-15 * self.direction
                    t += step
        return self.q


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("a", [1.0, 0.4])
def test_a_pendulum_sticks_and_slides_as_its_equation(drive, a):
    coulomb, mu = 0.03, 0.2
    plant = pendulum(
        drive, f"coulomb_friction:joint=1,torque={coulomb}", f"{NAME}:joint=1,coefficient={mu},transmitted={a}"
    )
    time = np.arange(0.0, 3.0, 0.02)
    volts = 3.2 * np.sin(3.0 * time) * np.sin(0.8 * time + 0.4) + 1.2 * np.sin(11.0 * time)
    on = (time < 2.2) | (time > 2.5)
    oracle = Oracle(drive, coulomb, mu, a, 0.3)
    expected = [0.3]
    for v, enable in zip(volts[:-1], on):
        expected.append(oracle.advance(v, 0.02, enable))
    simulator = Simulator(plant)
    simulator.reset([0.3])
    run = simulator.run(time, volts[:, None], enable=on.astype(float))
    assert oracle.stops >= 4 and oracle.starts >= 4
    assert_allclose(run.position[:, 0], expected, atol=2e-5)
    # the law is what made the motion: by the weight alone it is another one
    other = Simulator(pendulum(drive, f"coulomb_friction:joint=1,torque={coulomb}", f"{NAME}:joint=1,coefficient={mu}"))
    other.reset([0.3])
    assert np.abs(other.run(time, volts[:, None], enable=on.astype(float)).position - run.position).max() > 0.02


@pytest.mark.parametrize("drive", DRIVES)
def test_at_rest_it_holds_up_to_the_level_of_the_present_torque(drive):
    mu, a, q = 0.2, 1.0, 0.7
    gravity = WEIGHT * np.sin(q)
    # T - G = mu T going up, G - T = mu T going down
    for share, moves in (
        (0.998 / (1.0 - mu), 0),
        (1.002 / (1.0 - mu), 1),
        (1.002 / (1.0 + mu), 0),
        (0.998 / (1.0 + mu), -1),
    ):
        plant = pendulum(drive, f"{NAME}:joint=1,coefficient={mu},transmitted={a}")
        simulator = Simulator(plant)
        volts = share * gravity / KT * R
        simulator.reset([q], current=[share * gravity / KT if drive != "current" else volts])
        velocity = simulator.run([0.0, 0.05, 0.1], np.full((3, 1), volts)).velocity[-1, 0]
        assert np.sign(velocity) == moves, (share, velocity)
    # without current there is no load, and nothing holds it
    simulator = Simulator(pendulum(drive, f"{NAME}:joint=1,coefficient=0.9,transmitted=1"))
    simulator.reset([q])
    run = simulator.run([0.0, 0.05], np.zeros((2, 1)), enable=np.zeros(2))
    assert run.velocity[-1, 0] < -0.5


@pytest.mark.long
@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("soft", [False, True])
def test_a_bristle_yields_at_the_level_of_its_load(joint, soft):
    # led slowly, its bristle is bent as far as mu |T| bends it
    effects = [
        f"presliding_friction:joint={joint + 1},stiffness=2e4",
        f"{NAME}:joint={joint + 1},coefficient=0.2,transmitted=1",
    ]
    if soft:
        effects.append(f"joint_elasticity:joint={joint + 1},stiffness=2e4,damping=100")
    plant = plant_of(*effects)
    constraints = [HOLD] * 3
    constraints[joint] = Constraint("velocity", 1e-3)
    simulator = Simulator(plant, constraints=constraints)
    velocity = np.zeros(3)
    velocity[joint] = 1e-3
    simulator.reset((0.2, -1.0, 0.5), velocity)
    volts = np.zeros(3)
    volts[joint] = 4.0
    simulator.step(volts, 6.0)
    torque = plant.torque_per_ampere[joint] * simulator.state[6 + joint]
    assert simulator.bristles[joint] * 2e4 == pytest.approx(0.2 * torque, rel=1e-3)


@pytest.mark.parametrize(
    "effects, tolerance",
    [
        (["joint_elasticity:joint={},stiffness=5e5,damping=1000"], 3e-4),
        (["presliding_friction:joint={},stiffness=1e6"], 3e-4),
    ],
)
def test_a_stiff_drive_moves_as_a_rigid_one(effects, tolerance):
    time = np.arange(0.0, 0.8, 0.02)
    volts = np.column_stack([9 * np.sin(6 * time), 12 * np.cos(5 * time), 6 * np.sin(7 * time)])
    own = [f"viscous_friction:joint={j},coefficient=4" for j in (1, 2, 3)]
    own += [f"{NAME}:joint={j},coefficient=0.25,transmitted=0.8" for j in (1, 2, 3)]

    def moved(*more):
        simulator = Simulator(plant_of(*own, *more))
        simulator.reset((0.1, -1.2, 0.9))
        return simulator.run(time, volts).position

    rigid = moved()
    stiff = moved(*[text.format(j) for j in (1, 2, 3) for text in effects])
    assert np.abs(stiff - rigid).max() < tolerance
    own = own[:3]
    assert np.abs(moved() - rigid).max() > 10.0 * tolerance


# ------------------------------------------------------------------------------- nothing of it


#: runs with the law as it stands, or with |G| alone put in its place, which must give the same
PROGRAM = """
import sys
from dataclasses import replace

import numpy as np
from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.effects.base import Law, Point

if sys.argv[1] == "weight":
    name = "load_dependent_friction"
    weight = Law(Point.POSE_LEVEL, lambda p, k, q, gravity, torque: p[k] * abs(gravity))
    laws = tuple(weight if law.point is Point.POSE_LEVEL else law for law in KINDS[name].laws)
    KINDS[name] = replace(KINDS[name], laws=laws)
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator

friction = ["load_dependent_friction:joint=2,coefficient=0.2", "coulomb_friction:joint=1,torque=5",
            "load_dependent_friction:joint=3,coefficient=0.3,transmitted=0"]
more = {"dry": [], "bristle": ["presliding_friction:joint=2,stiffness=2e4"],
        "soft": ["joint_elasticity:joint=3,stiffness=2e4"]}

def found():
    rows = []
    time = np.arange(0.0, 0.3, 0.02)
    volts = np.column_stack([9 * np.sin(9 * time), 14 * np.cos(7 * time), -9 * np.sin(11 * time)])
    for effects in more.values():
        simulator = Simulator(Plant.of("bejczy", map(parse_effect, friction + effects)))
        simulator.reset((0.0, -1.1, 0.9))
        rows.append(simulator.run(time, volts).position)
    pendulum = load_mechanism("pendulum").plant(None, [parse_effect(
        "load_dependent_friction:joint=1,coefficient=0.2")])
    simulator = Simulator(pendulum)
    simulator.reset([0.4])
    rows.append(simulator.run(time, volts[:, :1] / 3.0).position)
    return b"".join(row.tobytes() for row in rows)

print(found().hex())
"""


def test_without_a_share_of_the_motor_it_is_friction_by_weight_to_the_bit():
    env = {**os.environ, "PUMA_SIM_KERNEL": "python"}
    command = [sys.executable, "-c", PROGRAM]
    laws = [subprocess.run([*command, law], env=env, capture_output=True, text=True) for law in ("own", "weight")]
    assert laws[0].returncode == 0 and len(laws[0].stdout) > 1000, laws[0].stderr[-2000:]
    assert laws[0].stdout == laws[1].stdout


def test_a_batch_gives_the_same_bits():
    time = np.arange(0.0, 0.4, 0.02)
    volts = np.column_stack([9 * np.sin(9 * time), 14 * np.cos(7 * time), -9 * np.sin(11 * time)])
    plants = [plant_of(f"{NAME}:joint=2,coefficient=0.2,transmitted=1"), plant_of()]
    result = run_batch(plants, time, volts, start=InitialState((0.1, -1.2, 0.9)))
    for n, plant in enumerate(plants):
        simulator = Simulator(plant)
        simulator.reset((0.1, -1.2, 0.9))
        assert bits(result.position[n]) == bits(simulator.run(time, volts).position)


# ---------------------------------------------------------------------------------- its columns


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_column_is_the_torque_that_the_gear_takes(joint):
    mu = 0.13
    run = recorded(str(Effect(KINDS[NAME], joint + 1, {"coefficient": mu, "transmitted": 1.0})))
    signals = signals_of(run.time, run.voltage, run.position, run.velocity, run.acceleration)
    found = {c.grid["transmitted"]: c for c in KINDS[NAME].screening.candidates(signals, joint)}
    mesh = mesh_share(signals, joint)
    # joint 1 bears no weight
    assert set(found) == ({mesh, 1.0} if joint == 0 else {0.0, mesh, 1.0})
    taken = (run.current * torque_per_ampere() - signals.torque)[:, joint]
    sliding = np.abs(signals.velocity[:, joint]) > 0.01
    columns = {a: c.columns[0][joint][sliding] for a, c in found.items()}
    fits = {a: float(x @ taken[sliding] / (x @ x)) for a, x in columns.items()}
    left = {
        a: np.linalg.norm(taken[sliding] - fits[a] * x) / np.linalg.norm(taken[sliding]) for a, x in columns.items()
    }
    assert fits[1.0] == pytest.approx(mu, rel=0.01) and left[1.0] < 0.02
    assert left.get(0.0, 1.0) > 5.0 * left[1.0]
    assert found[1.0].values([mu]) == {"coefficient": mu, "transmitted": 1.0}
    assert KINDS[NAME].parameter("transmitted").role is Role.STRUCTURE


def mesh_share(signals, joint):
    links = signals.link_inertia[:, joint].mean()
    return links / (links + signals.motor_inertia[joint])


@pytest.mark.parametrize("drive", ["voltage", "current"])
def test_one_of_its_columns_is_the_load_of_the_mesh(drive):
    """What the teeth bear is what the motor gives less what speeds up its rotor."""
    bare = load_mechanism("pendulum")
    plant = pendulum(drive)
    mechanism = type(bare).of(plant.body, plant.effects)
    time = np.arange(0.0, 2.0, 1e-3)
    volts = 2.5 * np.sin(6.0 * time[:, None]) + 1.5 * np.sin(17.0 * time[:, None])
    simulator = Simulator(plant)
    simulator.reset([0.2])
    run = simulator.run(time, volts, acceleration=True)
    signals = pendulum_signals(mechanism, run, volts)
    found = {c.grid["transmitted"]: c.columns[0][0] for c in KINDS[NAME].screening.candidates(signals, 0)}
    rotor = signals.torque - signals.viscous * signals.velocity - signals.motor_inertia * signals.acceleration
    mesh = np.abs(rotor[:, 0])
    share = mesh_share(signals, 0)
    assert 0.5 < share < 0.9
    left = {a: float(np.abs(np.abs(column) - mesh)[100:-100].max()) for a, column in found.items()}
    assert left[share] < 0.02 * mesh.max() < 0.1 * min(left[0.0], left[1.0])


def test_the_share_of_the_mesh_is_by_the_start_values():
    """A log of the geared pendulum stretched its rotor's inertia by 30 deviations where friction was missing."""
    from puma_sim_core.identify.data.log import Log
    from puma_sim_core.identify.data.sampling import sample
    from puma_sim_core.identify.screening.problem import Problem

    mechanism = load_mechanism("pendulum")
    time = np.arange(0.0, 4.0, 5e-3)
    volts = 2.6 * np.sin(4.0 * time[:, None])
    simulator = Simulator(mechanism.plant())
    simulator.reset([0.1])
    problem = Problem(sample([Log("made", time, volts, simulator.run(time, volts).position)]), mechanism)
    shares = []
    for theta in (mechanism.start, mechanism.clip(mechanism.start + 30.0 * mechanism.deviations)):
        found = KINDS[NAME].screening.candidates(problem.signals(theta), 0)
        shares.append(sorted(c.grid["transmitted"] for c in found))
    assert shares[0] == shares[1]
    assert shares[0][1] == pytest.approx(0.0049 / INERTIA, rel=1e-6)


def test_known_friction_by_torque_accounts_for_its_voltage():
    for drive in ("voltage", "current"):
        plant = pendulum(drive, f"{NAME}:joint=1,coefficient=0.2,transmitted=1", "coulomb_friction:joint=1,torque=0.02")
        bare = load_mechanism("pendulum")
        mechanism = type(bare).of(plant.body, plant.effects)
        time = np.arange(0.0, 1.0, 2e-4)
        volts = 2.5 * np.sin(6.0 * time[:, None])
        simulator = Simulator(plant)
        simulator.reset([0.2])
        run = simulator.run(time, volts, acceleration=True)
        signals = pendulum_signals(mechanism, run, 0.5 * (volts + np.roll(volts, 1, axis=0)))
        numbers = mechanism.drive(mechanism.start)
        model = numbers.volts_per_torque * signals.torque + numbers.emf * run.velocity
        known = known_voltage(mechanism, mechanism.start, signals)
        before = np.abs(signals.voltage - model)[200:-2]
        after = np.abs(signals.voltage - model - known)[200:-2]
        assert before.max() > 0.3
        assert np.quantile(after, 0.9) < 2e-3 + 0.002 * before.max()


def pendulum_signals(mechanism, run, voltage):
    from mechanism_support import signals_of as of_mechanism

    return of_mechanism(mechanism, run, voltage)


def test_the_explainer_names_the_load_that_made_the_log():
    """Screening of both loads on a log of the pendulum: the right one has the evidence."""
    from puma_sim_core.identify.data.log import Log
    from puma_sim_core.identify.data.sampling import sample
    from puma_sim_core.identify.screening.problem import Problem
    from puma_sim_core.identify.screening.search import Search

    mechanism = load_mechanism("pendulum")
    time = np.arange(0.0, 8.0, 5e-3)
    rng = np.random.default_rng(5)
    volts = (2.6 * np.sin(4.0 * time) + 1.6 * np.sin(13.0 * time + 1.0))[:, None]
    for a in (0.0, 1.0):
        simulator = Simulator(mechanism.plant(None, [parse_effect(f"{NAME}:joint=1,coefficient=0.15,transmitted={a}")]))
        simulator.reset([0.1])
        run = simulator.run(time, volts)
        log = Log("made", time, volts, run.position + 3e-4 * rng.standard_normal(volts.shape))
        library = {NAME: KINDS[NAME]}
        search = Search(Problem(sample([log]), mechanism), library)
        fit = search.retune(mechanism.start)
        (scored,) = search.ranked(fit, search.bank(fit.theta))
        assert scored.values["transmitted"] == a
        assert scored.values["coefficient"] == pytest.approx(0.15, rel=0.25)
        assert scored.gain > 50.0
