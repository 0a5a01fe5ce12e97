# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Section 7.4: radii of gyration estimated from motions of one joint at a time."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.plant.plant import Plant
from puma_sim_core.thesis.motions import HORIZONTAL, UPRIGHT
from puma_sim_core.thesis.radii import (
    LUMPS,
    SCALED,
    Campaign,
    gyration,
    lumps,
    with_friction,
    with_gyration,
    with_lumps,
)
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.tuning.estimation import Estimate, Record

OTHER_ARM = "The printed value is of the thesis's own robot, ours of the hidden one: not to be compared."
HIDDEN = (
    "The measured side is a hidden arm (other radii of gyration and friction of its own), "
    "driven by the servo and recorded through encoder counts, a 12-bit converter and noise; "
    "the estimator knows masses, centres of mass and motors, as the thesis does."
)


@lru_cache(maxsize=2)
def _campaign(seed: int) -> Campaign:
    return Campaign(Context(seed))


def _rows(name: str, unit: str, found, truth: float, printed, note: str = "") -> list[Row]:
    """Estimate, interval and truth of one parameter."""
    value, low, high = found
    inside = low <= truth <= high
    return [
        Row(f"{name}, estimate", unit, printed, value, note),
        Row(
            f"{name}, 95 % interval",
            unit,
            None,
            f"{low:.6g} to {high:.6g}",
            f"holds the truth, {truth:.6g}" if inside else f"does not hold the truth, {truth:.6g}",
        ),
    ]


def _numbers(prefix: str, found, truth: float) -> dict:
    value, low, high = found
    return {
        f"{prefix}_estimate": value,
        f"{prefix}_low": low,
        f"{prefix}_high": high,
        f"{prefix}_truth": truth,
        f"{prefix}_covered": bool(low <= truth <= high),
    }


def _fit_row(fit: Estimate) -> Row:
    return Row(
        "misfit of the tuned model, 1 if model and noise are right",
        "1",
        None,
        fit.misfit,
        f"as great by chance with probability {fit.probability:.2f}",
    )


def _figures(record: Record, joint: int, nominal: Plant, tuned: Plant, keys, what: str):
    """Positions with the nominal and the tuned value, their distance, and the voltage."""
    t = record.time[:: record.every]
    measured = record.angle[:, joint - 1]
    before, after = (record.simulated(plant)[:, joint - 1] for plant in (nominal, tuned))
    gap = float(np.abs(before - after).max())
    position, voltage = keys
    return gap, (
        Figure(
            voltage,
            f"Recorded voltage input to joint {joint}",
            "time [s]",
            "voltage [V]",
            (Curve("recorded", record.time, record.voltage[:, joint - 1]),),
        ),
        Figure(
            position,
            f"Position of joint {joint}, measured and simulated open loop",
            "time [s]",
            f"q{joint} [rad]",
            (
                Curve("measured", t, measured, "points"),
                Curve(f"nominal {what}", t, before),
                Curve(f"tuned {what}", t, after, "dashed"),
            ),
            f"Nominal and tuned differ by at most {gap:.4f} rad and can hardly be told apart on the scale of the plot.",
        ),
        Figure(
            f"{position}-difference",
            f"Simulated less measured angle of joint {joint}",
            "time [s]",
            "rad",
            (
                Curve(f"nominal {what}", t, before - measured, "line"),
                Curve(f"tuned {what}", t, after - measured, "points"),
            ),
            "Where the radius shows: steps of the lag while the joint gathers and loses speed.",
        ),
    )


def _gap_row(gap: float, what: str, shift: str) -> Row:
    return Row(
        f"greatest distance between the motions with nominal and tuned {what}",
        "rad",
        "improved the likeness",
        gap,
        "Does not reproduce at the size that the text suggests: in open loop the back-EMF "
        f"sets the speed, and an inertia only a lag of milliseconds. {shift}",
    )


@experiment("7.4.1", "Radius of gyration of link 3 about its joint", chapter="7.4")
def elbow(context: Context) -> Result:
    """k3yy from joint 3, the others locked."""
    c = _campaign(context.seed)
    fit, truth = c.elbow, gyration(c.hidden(3), "k3yy")
    found = fit.of("k3yy")
    dry, viscous = fit.values[1], fit.values[2]
    gap, figures = _figures(
        c.elbow_records[0],
        3,
        with_friction(c.nominal, 3, dry, viscous),
        with_friction(with_gyration(c.nominal, {"k3yy": found[0]}), 3, dry, viscous),
        ("7.7", "7.6"),
        "k3yy",
    )
    lag = _lag(c.nominal, 3, UPRIGHT)
    context.progress(1.0)
    return Result(
        f"k3yy of the hidden arm comes out as {found[0]:.5f} m^2 ({found[1]:.5f} to "
        f"{found[2]:.5f}), its truth is {truth:.5f}. {HIDDEN} The thesis writes k3zz here; the "
        "axis of joint 3 is y3 in its own frames, and D33 holds k3yy.",
        (
            Row("k3yy, where the estimator starts", "m^2", 0.0786, gyration(c.nominal, "k3yy")),
            *_rows("k3yy", "m^2", found, truth, 0.0691, OTHER_ARM),
            Row("dry friction of joint 3, estimated with it", "N.m", None, dry, f"truth {c.friction[2][0]:.4g}"),
            Row(
                "viscous friction of joint 3, estimated with it",
                "N.m.s/rad",
                None,
                viscous,
                f"truth {c.friction[2][1]:.4g}",
            ),
            _fit_row(fit),
            _gap_row(gap, "k3yy", f"The lag is {1e3 * lag:.1f} ms for joint 3, and k3yy makes less than half of it."),
        ),
        figures,
        _numbers("k3yy", found, truth) | {"greatest_gap_rad": gap},
    )


def _lag(plant: Plant, joint: int, pose) -> float:
    """Mechanical time constant [s] of a joint, R M / (kT ke N)."""
    motor = plant.arm.motors[joint - 1]
    M = inertia(np.array(pose), plant.arm)[joint - 1, joint - 1] + motor.inertia
    return motor.resistance * M / (plant.torque_per_ampere[joint - 1] * motor.back_emf * motor.gear_ratio)


@experiment("7.4.2", "Radius of gyration of link 2 about its joint", chapter="7.4")
def shoulder(context: Context) -> Result:
    """k2zz from joint 2 with the forearm folded."""
    c = _campaign(context.seed)
    lag = _lag(c.nominal, 2, c.shoulder_records[0].start)
    fit, truth = c.shoulder, gyration(c.hidden(2), "k2zz")
    found = fit.of("k2zz")
    friction = fit.values[2], fit.values[3]
    folded = with_gyration(c.nominal, {"k3yy": fit.values[1]})
    gap, figures = _figures(
        c.shoulder_records[0],
        2,
        with_friction(folded, 2, *friction),
        with_friction(with_gyration(folded, {"k2zz": found[0]}), 2, *friction),
        ("7.8", "7.9"),
        "k2zz",
    )
    context.progress(1.0)
    return Result(
        f"k2zz of the hidden arm comes out as {found[0]:.5f} m^2 ({found[1]:.5f} to "
        f"{found[2]:.5f}), its truth is {truth:.5f}. k3yy enters as 7.4.1 gave it, with its own "
        f"uncertainty. {HIDDEN}",
        (
            Row("k2zz, where the estimator starts", "m^2", 0.1514, gyration(c.nominal, "k2zz")),
            *_rows(
                "k2zz",
                "m^2",
                found,
                truth,
                0.0031,
                f"{OTHER_ARM} The print is no possible value: the square of the distance "
                "of the mass centre from the axis alone is 0.108 m^2. The text says that k2zz "
                "was increased.",
            ),
            _fit_row(fit),
            _gap_row(gap, "k2zz", f"The lag is {1e3 * lag:.1f} ms for joint 2."),
        ),
        figures,
        _numbers("k2zz", found, truth) | {"greatest_gap_rad": gap},
    )


@experiment("7.4.3", "Radii of gyration seen by joint 1, arm upright", chapter="7.4")
def upright(context: Context) -> Result:
    """k1yy, k2xx and k3zz scaled by one factor."""
    c = _campaign(context.seed)
    fit, hidden = c.upright, c.hidden(1)
    masses = {name: hidden.arm.links[int(name[1]) - 1].mass for name in SCALED}
    weight = sum(m * gyration(c.nominal, name) for name, m in masses.items())
    total = fit.combined({"factor": weight})
    true_total = sum(m * gyration(hidden, name) for name, m in masses.items())
    rows = [
        Row(
            "common factor of k1yy, k2xx and k3zz",
            "1",
            "below 1",
            fit.of("factor")[0],
            "The text too scales the three down.",
        ),
        *_rows(
            "m1 k1yy + m2 k2xx + m3 k3zz",
            "kg.m^2",
            total,
            true_total,
            None,
            "What the test can see: joint 1 has one inertia, and it holds the sum.",
        ),
        Row(
            "k1yy, k2xx and k3zz each",
            "m^2",
            "scaled in proportion",
            "not identifiable",
            "One number cannot give three. What follows is the proportion that was assumed, not a measurement.",
        ),
    ]
    numbers = _numbers("sum", total, true_total)
    for name, printed in (("k1yy", 0.0141), ("k2xx", 0.0516), ("k3zz", 0.0027)):
        scale = gyration(c.nominal, name)
        found = tuple(scale * v for v in fit.of("factor"))
        rows += _rows(f"{name}, if in proportion", "m^2", found, gyration(hidden, name), printed, OTHER_ARM)
        numbers |= _numbers(f"{name}_in_proportion", found, gyration(hidden, name))
    friction = fit.values[1], fit.values[2]
    gap, figures = _figures(
        c.upright_records[0],
        1,
        with_friction(c.nominal, 1, *friction),
        with_friction(c.scaled(fit.values[0]), 1, *friction),
        ("7.10", "7.11"),
        "k1yy, k2xx, k3zz",
    )
    missed = sum(not numbers[f"{name}_in_proportion_covered"] for name in SCALED)
    lag = _lag(c.nominal, 1, UPRIGHT)
    rows += [_fit_row(fit), _gap_row(gap, "radii", f"The lag is {1e3 * lag:.1f} ms for joint 1 upright.")]
    context.progress(1.0)
    return Result(
        f"The sum m1 k1yy + m2 k2xx + m3 k3zz comes out as {total[0]:.4f} kg.m^2 ({total[1]:.4f} "
        f"to {total[2]:.4f}), its truth is {true_total:.4f}. Each of the three by itself is not to "
        "be had from this test: the thesis assumed that they were in proportion, and so does the "
        f"repetition: {missed} of its 3 intervals do not hold the truth. {HIDDEN} "
        "The thesis writes k3yy and k1zz; upright, D11 holds k3zz and k1yy.",
        tuple(rows),
        figures,
        numbers | {"greatest_gap_rad": gap},
    )


@experiment("7.4.4", "The remaining radii of gyration", chapter="7.4")
def remaining(context: Context) -> Result:
    """k2yy as in the text, then what three poses together do give."""
    c = _campaign(context.seed)
    fit, waist, hidden = c.stretched, c.waist, c.hidden(1)
    found, truth = fit.of("k2yy"), gyration(hidden, "k2yy")
    rows = [
        Row("k2yy, where the estimator starts", "m^2", 0.1930, gyration(c.nominal, "k2yy")),
        *_rows(
            "k2yy by the text's procedure",
            "m^2",
            found,
            truth,
            0.1900,
            f"{OTHER_ARM} In this pose D11 holds m1 k1yy + m2 k2yy + m3 k3xx; whatever was "
            "wrong with k1yy and k3xx before goes into k2yy, and the interval knows nothing "
            "of it.",
        ),
    ]
    numbers = _numbers("k2yy", found, truth)
    meaning = {"s": "m1 k1yy + m2 k2xx + m3 k3xx", "p": "m2 (k2yy - k2xx)", "r": "m3 (k3zz - k3xx)"}
    for name, value, start in zip(LUMPS, lumps(hidden), lumps(c.nominal)):
        rows += _rows(
            f"{name} = {meaning[name]}, three poses",
            "kg.m^2",
            waist.of(name),
            float(value),
            None,
            f"The estimator starts from {start:.4f}.",
        )
        numbers |= _numbers(name, waist.of(name), float(value))
    rows.append(
        Row(
            "k1yy, k2xx, k2yy, k3xx and k3zz each",
            "m^2",
            "table 7.1",
            "not identifiable",
            "Five radii enter the equations of motion through s, p and r alone, so that "
            "no test on the arm separates them. Table 7.1 holds k2zz, k3yy and three "
            "sums; the rest of it is assumption.",
        )
    )
    friction = fit.values[2], fit.values[3]
    before = c.scaled(fit.values[1])
    gap, figures = _figures(
        c.stretched_records[0],
        1,
        with_friction(before, 1, *friction),
        with_friction(with_gyration(before, {"k2yy": found[0]}), 1, *friction),
        ("7.12", "7.13"),
        "k2yy",
    )
    tuned = with_lumps(c.nominal, *waist.values[:3])
    worst = max(
        abs(inertia(np.array(q), tuned.arm)[0, 0] - inertia(np.array(q), hidden.arm)[0, 0])
        for q in ((0.0, a, b) for a in np.linspace(-3.8, 0.7, 19) for b in np.linspace(-0.9, 4.0, 21))
    )
    lag = _lag(c.nominal, 1, HORIZONTAL)
    rows += [
        _fit_row(waist),
        Row(
            "greatest error of D11 anywhere, from the three lumps",
            "kg.m^2",
            None,
            float(worst),
            "With the sums right the model is right, whatever their parts.",
        ),
        _gap_row(gap, "k2yy", f"The lag is {1e3 * lag:.1f} ms for joint 1 stretched."),
    ]
    context.progress(1.0)
    return Result(
        f"By the text's procedure k2yy comes out as {found[0]:.4f} m^2 where the truth is "
        f"{truth:.4f}: the pose does not separate it from k1yy and k3xx, and its interval "
        f"{'holds by luck' if numbers['k2yy_covered'] else 'does not hold'}. Three poses "
        "of joint 1 give three sums of five radii, with "
        "intervals that hold, and D11 in every pose; the five by themselves cannot be had from any "
        f"test on the arm. {HIDDEN}",
        tuple(rows),
        figures,
        numbers | {"greatest_gap_rad": gap},
    )
