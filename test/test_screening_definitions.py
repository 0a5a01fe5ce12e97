# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What every kind's screening promises: legal values, reasons for illegal ones, look-alikes."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from screening_support import DRIVE, recorded, reference, resistance, signals_of

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.effects.backlash import _knock
from puma_sim_core.effects.joint_elasticity import _swing
from puma_sim_core.effects.relations import CONTAINS, EXACT_TIES, LOOK_ALIKES
from puma_sim_core.effects.screening import Illegal, Screening, Signals
from puma_sim_core.effects.shared.columns import derivative, recursion, smooth_sign
from puma_sim_core.jit import interpreted

SCREENINGS = {name: kind.screening for name, kind in KINDS.items() if kind.screening is not None}
WHOLE_ARM = [name for name, kind in KINDS.items() if not kind.per_joint]
every_name = pytest.mark.parametrize("name", list(SCREENINGS))


@pytest.fixture(scope="module")
def plain():
    """Signals of the arm without effects; a residual for what looks at it."""
    run = recorded()
    wave = np.sin(np.arange(len(run.time)) ** 1.1)
    return signals_of(
        run.time, run.voltage, run.position, run.velocity, run.acceleration, residual=wave[:, None] * np.ones(3)
    )


def cut(signals: Signals, rows=slice(None), joints=None, **changes) -> Signals:
    """Signals of some rows, or of some joints."""
    n, J = signals.position.shape
    made = {}
    for f in fields(signals):
        values = getattr(signals, f.name)
        if isinstance(values, np.ndarray) and values.shape[:1] == (n,):
            values = values[rows]
            if joints is not None and values.shape[1:] == (J,):
                values = values[:, joints]
            made[f.name] = values
        elif isinstance(values, np.ndarray) and joints is not None and values.shape == (J,):
            made[f.name] = values[joints]
    return replace(signals, **{**made, **changes})


def test_all_kinds_but_viscous_friction_can_be_looked_for():
    assert set(SCREENINGS) == set(KINDS) - {"viscous_friction"}


@every_name
def test_definition_is_whole(name):
    kind, screening = KINDS[name], SCREENINGS[name]
    assert isinstance(screening, Screening)
    known = {p.name for p in kind.parameters}
    assert kind.plausible and {p for p, _, _ in kind.plausible} <= known
    assert all(0.0 <= low < high for _, low, high in kind.plausible)
    assert kind.look_alikes and name not in {pair.other for pair in kind.look_alikes}
    assert {pair.other for pair in kind.look_alikes} | set(kind.contains) <= set(SCREENINGS)
    assert screening.excitation.endswith(".")


def test_each_pair_of_look_alikes_stands_once_and_holds_both_ways():
    """Whoever may be mistaken for another has an answer when the other is named."""
    pairs = [frozenset(pair[:2]) for pair in LOOK_ALIKES]
    assert len(set(pairs)) == len(pairs) and all(len(pair) == 2 for pair in pairs)
    for one, other, mine, its in LOOK_ALIKES:
        assert KINDS[one].told_from(other) == mine and KINDS[other].told_from(one) == its
    assert set(CONTAINS) <= set(KINDS) and all(set(found) <= set(KINDS) for found in CONTAINS.values())


@every_name
def test_candidates_are_numbers_that_the_model_takes(plain, name):
    """Columns of the right length, finite; the means of the priors are legal values."""
    seen = 0
    for joint in [None] if name in WHOLE_ARM else range(3):
        for candidate in SCREENINGS[name].candidates(plain, joint):
            seen += 1
            p = len(candidate.columns)
            assert candidate.mean.shape == candidate.deviation.shape == (p,)
            assert (candidate.deviation > 0.0).all()
            for column in candidate.columns:
                assert joint is None or joint in column or name == "encoder_offset"
                for values in column.values():
                    assert values.shape == plain.time.shape and np.isfinite(values).all()
            values = candidate.values(candidate.mean)
            Effect(KINDS[name], None if joint is None else joint + 1, values)
            if not candidate.fixed:
                with pytest.raises(Illegal, match=r"\d"):
                    candidate.values(candidate.mean - 1e4 * candidate.deviation)
    assert seen > 0


#: what acts on an arm at rest too
SEEN_AT_REST = {
    "voltage_offset",
    "joint_spring",
    "payload",
    "base_tilt",
    "encoder_offset",
    "resistance_drift",
    "voltage_dead_band",
    "supply_droop",
    "voltage_saturation",
    "current_limit",
    "input_delay",
    "impulse",
}


@pytest.mark.parametrize("name", [name for name in SCREENINGS if name not in SEEN_AT_REST])
def test_an_arm_at_rest_shows_no_effect_of_motion(plain, name):
    """At rest, columns of what needs motion are zero or are not offered."""
    still = np.repeat(plain.position[:1], len(plain.time), axis=0)
    signals = signals_of(plain.time, np.zeros_like(still), still, 0.0 * still, 0.0 * still)
    for joint in range(3):
        for candidate in SCREENINGS[name].candidates(signals, joint):
            for column in candidate.columns:
                assert all(not values.any() for values in column.values())


def test_stretches_of_a_log_do_not_touch_each_other(plain):
    """What has a memory begins anew in each stretch: two halves give what each gives alone."""
    half = len(plain.time) // 2
    broken = replace(plain, segment=(np.arange(len(plain.time)) >= half).astype(int))
    for name, n in (("presliding_friction", 4), ("input_delay", 3)):
        joint = None if name in WHOLE_ARM else 0
        candidates = SCREENINGS[name].candidates
        whole = candidates(broken, joint)[n].columns[0][0]
        for rows in (slice(0, half), slice(half, None)):
            assert np.array_equal(candidates(cut(plain, rows), joint)[n].columns[0][0], whole[rows])


def test_one_joint_with_a_current_controlled_amplifier(plain):
    """Effects of arms are not offered; all others have finite columns and legal means."""
    single = cut(
        plain,
        joints=[0],
        lag=np.zeros(1),
        emf=np.zeros(1),
        gear=np.ones(1),
        ranges=plain.ranges[:1],
        gravity_tilt=None,
        payload_torque=None,
        inertia=None,
        position_gradient=None,
    )
    offered = set()
    for name, screening in SCREENINGS.items():
        for candidate in screening.candidates(single, None if name in WHOLE_ARM else 0):
            offered.add(name)
            candidate.values(candidate.mean)
            for column in candidate.columns:
                assert set(column) == {0} and np.isfinite(column[0]).all()
    assert {"payload", "base_tilt", "current_limit", "encoder_offset"}.isdisjoint(offered)
    assert {
        "coulomb_friction",
        "presliding_friction",
        "backlash",
        "joint_elasticity",
        "input_delay",
        "soft_stop",
        "joint_spring",
    } <= offered


def test_ties_that_no_log_can_break_are_sentences():
    assert all(one and other and why and not why.endswith(".") for one, other, why in EXACT_TIES)


def test_compiled_and_plain_python_give_the_same_bits():
    rng = np.random.default_rng(5)
    torque, inertia = 20.0 * rng.standard_normal(200), 3.0 + rng.random(200)
    flow = 0.5 * rng.standard_normal((200, 4))
    for function, arguments in (
        (recursion, (rng.random(200), torque, 0.3)),
        (_swing, (flow, torque / 2e4, 1e-3, 2e-3, 0.1)),
        (_knock, (torque, inertia, 2e-4, 5, 5e-4, 2e5, 900.0, 4.0)),
    ):
        assert np.array_equal(function(*arguments), interpreted(function)(*arguments))


def test_smooth_sign_and_derivative(plain):
    v = np.array([-1.0, -0.02, 0.0, 0.02, 1.0])
    assert smooth_sign(v, 0.01) == pytest.approx([-1.0, -(0.5**0.5), 0.0, 0.5**0.5, 1.0], abs=2e-4)
    assert np.array_equal(smooth_sign(np.zeros(3), 0.0), np.zeros(3))
    t = plain.time
    assert derivative(3.0 * t**2, plain) == pytest.approx(6.0 * t, abs=1e-9)


def test_reference_is_what_it_says():
    t = np.arange(1000) * 1e-4
    q, qd, qdd = reference(t)
    assert np.gradient(q, 1e-4, axis=0)[1:-1] == pytest.approx(qd[1:-1], abs=1e-4)
    assert np.gradient(qd, 1e-4, axis=0)[1:-1] == pytest.approx(qdd[1:-1], abs=1e-3)
    assert (resistance() > 0.0).all() and (DRIVE.lag > 0.0).all()
