# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Makes records from recipes: `python test/blind/generate.py --out DIR --seed 2000 --nothing 20`.

Each record is a CSV, and its answer an entry of `answers.json` beside it. The same recipe gives
the same bytes.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

if __name__ == "__main__" and not __package__:
    # run as a script: the package is this folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    __package__ = "blind"

from blind import arm_parameters as arm
from blind import cases, faults, motions, outside, records
from blind.drives import Controller, Run, Sampling, simulate
from blind.effects import EFFECTS, NO_STOP, Plant, derived, scaled
from blind.size import Sizes, measure

#: how near (in ratio) the size of a record comes to what was asked for
_NEAR = 1.2
_TRIES = 6
#: motions that are tried with the same effects, and how often these are drawn
_MOTIONS, _DRAWS = 6, 4


class Rig:
    """One plant with one way of driving it: motion, controller and noise are drawn and kept."""

    def __init__(self, recipe: records.Recipe, motion_seed: int, parameters: arm.Parameters):
        self.recipe, self.parameters = recipe, parameters
        rng = recipe.random(3, motion_seed)
        self.sampling = Sampling(recipe.period)
        self.samples = round(recipe.seconds / recipe.period)
        named = [joint for _, joint in recipe.effects] + ([recipe.outside[1]] if recipe.outside else [])
        joint = named[0] if named else None
        self.motion = recipe.motion or str(rng.choice(["fourier", "wide", "points", "triangles", "bang", "repeat"]))
        if not recipe.feedback and self.motion in ("crawl", "micro", "triangles", "constant"):
            self.motion = "fourier"
        rows = np.arange(self.samples * self.sampling.rows + 1) * self.sampling.row
        fine = motions.reference(self.motion, rng, rows, joint)
        self.controller = self._controller(rng, fine)
        noise_rng = recipe.random(4, motion_seed)
        self.volts = round(0.05 * noise_rng.uniform(0.8, 1.25), 4)
        self.torque = round(0.15 * noise_rng.uniform(0.8, 1.25), 4)
        self.correlation = round(float(10 ** noise_rng.uniform(0.7, 1.7)), 2) if recipe.coloured else 0.0
        self.noise = self._noise(noise_rng, self.volts)
        self.torque_noise = self._noise(noise_rng, self.torque)

    def _controller(self, rng, fine) -> Controller:
        each, n, step = self.sampling.rows, self.samples, self.sampling.row
        start = arm.nominal()
        setpoint = fine[::each][:n].copy()
        emf = start["ke"] * arm.GEAR
        crossover = rng.uniform(7.0, 18.0, 3) * (0.6 if self.sampling.period > 0.01 else 1.0)
        kp = np.round(crossover * emf, 2)
        ki = np.round(kp / rng.uniform(0.5, 2.0, 3), 2) * (rng.random() < 0.7)
        kd = np.round(kp * rng.uniform(0.0, 0.01, 3), 3) * (rng.random() < 0.4)
        if self.recipe.case == "delay_oscillating":
            draws = self.recipe.random(5)
            delay = cases.CASES[self.recipe.case].draw["input_delay"](draws, None, None)["time"]
            joint, kp[joint] = cases.oscillating_gain(draws, delay, self.sampling.period)
        rate = np.gradient(fine, step, axis=0)
        forward = rng.random() < 0.5
        band = next((EFFECTS[name].band for name, _ in self.recipe.effects if EFFECTS[name].band), None)
        low, high = band or (1.0, 8.0)
        time = np.arange(n) * self.sampling.period
        waves = motions.dither(rng, time, np.ones(3), (low, min(high, 0.43 / time[1])))
        strength = rng.uniform(2.0, 5.0) if band else rng.uniform(1.0, 4.0)
        self.dithered = None
        feed = np.zeros((n, 3))
        if self.recipe.feedback:
            feed += arm.gravity(fine[:1], start) * start["R"] / (arm.GEAR * start["kt"])
            if forward:
                feed += (rate * emf)[::each][:n]
            on_setpoint = rng.random() < 0.4 and not band
            if self.recipe.dither and on_setpoint:
                setpoint += waves * rng.uniform(0.01, 0.04)
                self.dithered = "setpoint"
            elif self.recipe.dither:
                feed += waves * strength
                self.dithered = "voltage"
        else:
            wanted = arm.voltage(fine, rate, np.gradient(rate, step, axis=0), step, start)
            feed += wanted[: n * each].reshape(n, each, 3).mean(axis=1)
            kp, ki, kd = np.zeros((3, 3))
            if self.recipe.dither:
                feed += waves * strength
                self.dithered = "voltage"
        return Controller(np.round(feed, 9), np.round(setpoint, 9), kp, ki, kd)

    def _noise(self, rng, deviation: float) -> np.ndarray:
        white = rng.standard_normal((self.samples, 3))
        if self.correlation:
            keep = float(np.exp(-1000.0 * self.sampling.period / self.correlation))
            for k in range(1, self.samples):
                white[k] = keep * white[k - 1] + np.sqrt(1.0 - keep**2) * white[k]
        return np.round(deviation * white, 9)

    def run(self, plant: Plant) -> Run:
        return simulate(
            self.parameters,
            plant.mechanics,
            plant.table,
            plant.droop,
            plant.delay,
            self.controller,
            self.sampling,
            self.noise,
            self.torque_noise,
        )

    def sizes(self, run: Run) -> Sizes:
        return measure(run, self.parameters, self.sampling, self.noise, self.torque_noise)

    def in_range(self, run: Run) -> bool:
        return bool(
            np.isfinite(run.motion).all()
            and (run.motion > arm.RANGES[:, 0] + 0.02).all()
            and (run.motion < arm.RANGES[:, 1] - 0.02).all()
        )


def make(recipe: records.Recipe, folder, check: bool = False) -> tuple[Path, dict]:
    """Writes the record of a recipe (and its check record) into `folder`: (path, answer)."""
    started = time.perf_counter()
    parameters = arm.wrong(recipe.random(2))
    # a limit may not hold up a payload in any motion: then both are drawn again
    for attempt in range(_MOTIONS * _DRAWS):
        rig = Rig(recipe, recipe.seed + 10_000_000 * attempt, parameters)
        placed, outsider = _scaled_effects(recipe, rig, attempt // _MOTIONS)
        plant = _plant(placed, outsider)
        run = rig.run(plant)
        if rig.in_range(run):
            break
    else:
        raise RuntimeError(f"{recipe.name}: no motion stays within the joints' ranges")
    sizes = rig.sizes(run)
    answer = _answer(recipe, rig, placed, outsider, sizes)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{recipe.name}.csv"
    answer["faults"] = _write(path, recipe, rig, run, recipe.fault)
    if check:
        for attempt in range(6):
            other = Rig(recipe, recipe.seed + 5_000_000 + 10_000_000 * attempt, parameters)
            run = other.run(plant)
            if other.in_range(run):
                break
        _write(folder / f"{recipe.name}_check.csv", recipe, other, run, None)
    answer["seconds_to_make"] = round(time.perf_counter() - started, 2)
    return path, answer


def _plant(placed, outsider) -> Plant:
    plant = Plant()
    for name, joint, parameters, *_ in placed:
        EFFECTS[name].put(plant, joint, parameters)
    if outsider:
        outside.put(plant.table, *outsider[:3])
    return plant


def _scaled_effects(recipe, rig, again: int = 0):
    """Effects as (name, joint, parameters, size, distinct, strain), each scaled by itself, or drawn by its case.

    again : how often they were drawn before.
    """
    placed, peaks = [], None
    rng = recipe.random(5 + 10 * again)
    draw = cases.CASES[recipe.case].draw if recipe.case else {}
    for (name, joint), target in zip(recipe.effects, recipe.sizes):
        if name in draw:
            asked = None if joint is None else _demand(rig, rig.run(_plant(placed, None)))[joint]
            placed.append((name, joint, *_drawn(rig, name, joint, draw[name](rng, joint, asked))))
            continue
        if peaks is None:
            peaks = _peaks(rig)
        effect = EFFECTS[name]
        drawn = effect.draw(rng, joint)

        def parameters_of(strength, name=name, effect=effect, drawn=drawn, joint=joint):
            peak = peaks[joint] if joint is not None else None
            return derived(name, scaled(effect, drawn, strength), peak, recipe.seconds)

        def size_of(strength, name=name, joint=joint, parameters_of=parameters_of):
            parameters = parameters_of(strength)
            sizes = rig.sizes(rig.run(_plant([(name, joint, parameters)], None)))
            return parameters, sizes

        least, top, start = effect.least, effect.most(joint), effect.start
        if effect.free:
            least = top = start = float(10 ** rng.uniform(*effect.free))
        placed.append((name, joint, *_search(size_of, joint, target, start, least, top)))
    outsider = None
    if recipe.outside:
        name, joint = recipe.outside
        made = outside.OUTSIDE[name]
        drawn = tuple(float(x) for x in made.draw(rng, joint))

        def outsider_of(strength):
            values = tuple(float(f"{x:.6g}") for x in (drawn[0] * strength, *drawn[1:]))
            return values, rig.sizes(rig.run(_plant([], (name, joint, values))))

        outsider = (name, joint, *_search(outsider_of, joint, recipe.sizes[0], made.start, 0.0, made.most))
    return placed, outsider


def _search(size_of, joint, target, strength, least, top):
    """Strength whose size is the target, as far as the physical range goes."""
    best, below, above = None, None, None
    for _ in range(_TRIES):
        strength = float(f"{max(min(strength, top), least):.4g}")
        parameters, sizes = size_of(strength)
        size = max(overall(sizes, joint), 1e-6)
        distance = abs(np.log(size / target))
        if best is None or distance < best[0]:
            best = (distance, parameters, size, sizes)
        if (
            distance < np.log(_NEAR)
            or (size < target and strength >= 0.999 * top)
            or (size > target and strength <= 1.001 * least)
        ):
            break
        if size < target:
            below = (strength, size)
        else:
            above = (strength, size)
        if below and above:
            # sizes may jump: between two that enclose the target, a power law
            share = np.log(target / below[1]) / np.log(above[1] / below[1])
            share = float(np.clip(share, 0.15, 0.85))
            strength = below[0] * (above[0] / below[0]) ** share
        else:
            strength *= float(np.clip(target / size, 0.05, 12.0))
    _, parameters, size, sizes = best
    distinct = float(sizes.distinct[joint]) if joint is not None else size
    return parameters, size, distinct, float(np.hypot(size, sizes.strain))


def overall(sizes: Sizes, joint: int | None) -> float:
    """Size on the joint; for the whole arm over all joints, with what the priors of the
    retuned parameters are strained by (a payload can be had by retuning far beyond them)."""
    if joint is not None:
        return float(sizes.ratio[joint])
    return float(np.sqrt((sizes.ratio**2).sum() + sizes.strain**2))


def _drawn(rig: Rig, name: str, joint: int | None, parameters: dict):
    """Parameters with the sizes that they have."""
    sizes = rig.sizes(rig.run(_plant([(name, joint, parameters)], None)))
    size = max(overall(sizes, joint), 1e-6)
    distinct = float(sizes.distinct[joint]) if joint is not None else size
    return parameters, size, distinct, float(np.hypot(size, sizes.strain))


def _demand(rig: Rig, run: Run) -> list[cases.Demand]:
    """What a run asks of each joint."""
    p, step = rig.parameters, rig.sampling.row
    q = run.motion
    rate = np.gradient(q, step, axis=0)
    per_torque = 1.0 / (p["kt"] * arm.GEAR)
    current = (arm.motor_torque(q, rate, np.gradient(rate, step, axis=0), p) * per_torque)[10:-10]
    holding = arm.gravity(q, p) * per_torque
    columns = (q, run.commanded, current, holding, holding * p["R"])
    return [cases.Demand(*(column[:, j] for column in columns)) for j in range(3)]


def _peaks(rig: Rig) -> list[dict]:
    """What each joint reaches without effects."""
    return [
        {
            "low": float(asked.position.min()),
            "high": float(asked.position.max()),
            "voltage": float(np.abs(asked.voltage).max()),
            "current": float(np.abs(asked.current).max()),
        }
        for asked in _demand(rig, rig.run(Plant()))
    ]


def _answer(recipe, rig, placed, outsider, sizes: Sizes) -> dict:
    def rounded(x):
        return [float(f"{value:.4g}") for value in x]

    effects = [
        {
            "name": name,
            "joint": None if joint is None else joint + 1,
            "parameters": {
                key: value
                for key, value in parameters.items()
                if key not in ("lower", "upper") or abs(value) != NO_STOP
            },
            "size": float(f"{size:.4g}"),
            "distinct_size": float(f"{distinct:.4g}"),
            "size_with_priors": float(f"{strained:.4g}"),
        }
        for name, joint, parameters, size, distinct, strained in placed
    ]
    answer = {"effects": effects, "size": None, "outside": None, "faults": []}
    if effects:
        answer["size"] = max(effect["size"] for effect in effects)
    if outsider:
        name, joint, values, size, *_ = outsider
        axes = outside.OUTSIDE[name].axes(values)
        answer["outside"] = {"what": name, "joint": joint + 1, "axis": axes[0], "also": axes[1:], "values": values}
        if name == "shake_in_time":
            answer["outside"]["line_hz"] = values[1]
        answer["size"] = float(f"{size:.4g}")
    answer.update(
        recipe=asdict(recipe),
        seed=recipe.seed,
        sampling_ms=round(1000 * recipe.period, 4),
        seconds=recipe.seconds,
        feedback=recipe.feedback,
        dither=rig.dithered,
        motion=rig.motion,
        correlation_ms=rig.correlation,
        noise={"voltage": rig.volts, "torque": rig.torque, "floor": rounded(sizes.floor)},
        truth={"raw_rms": rounded(sizes.raw), "kept_rms": rounded(sizes.voltage)},
        parameters={name: value.tolist() for name, value in rig.parameters.items()},
        gains={key: getattr(rig.controller, key).tolist() for key in ("kp", "ki", "kd")},
    )
    return answer


def _write(path: Path, recipe, rig: Rig, run: Run, fault: str | None) -> list[dict]:
    log = {"time": np.arange(rig.samples) * recipe.period}
    for j in range(3):
        log[f"voltage{j + 1}"] = run.commanded[:, j]
    for j in range(3):
        log[f"position{j + 1}"] = run.measured[:, j]
    if recipe.setpoint and recipe.feedback:
        for j in range(3):
            log[f"setpoint{j + 1}"] = rig.controller.setpoint[:, j]
    found = []
    if fault:
        log, found = faults.spoil(fault, log, recipe.random(6))
    digits = {"time": 7, "voltage": 4, "position": 6, "setpoint": 5}
    columns = [[_number(x, digits[name.rstrip("123")]) for x in values] for name, values in log.items()]
    lines = [",".join(log)] + [",".join(row) for row in zip(*columns)]
    if fault:
        lines, more = faults.spoil_text(fault, lines, recipe.random(7))
        found = found + more
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")
    return found


def _number(x, digits: int) -> str:
    text = f"{x:.{digits}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def make_all(recipes, folder, check: bool = False, processes: int = 1) -> dict[str, dict]:
    """All records of a plan, and `answers.json`: name -> answer."""
    job = partial(make, folder=folder, check=check)
    if processes > 1:
        with ProcessPoolExecutor(processes) as pool:
            made = list(pool.map(job, recipes))
    else:
        made = [job(recipe) for recipe in recipes]
    answers = {path.stem: answer for path, answer in made}
    seconds = {name: answer.pop("seconds_to_make") for name, answer in answers.items()}
    text = json.dumps(answers, indent=1, sort_keys=True)
    (Path(folder) / "answers.json").write_text(text + "\n", encoding="ascii")
    return seconds


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", required=True)
    parser.add_argument("--seed", type=int, default=2000, help="of the first record")
    for kind in records.KINDS:
        parser.add_argument(f"--{kind}", type=int, default=0, metavar="N")
    parser.add_argument("--committed", action="store_true", help="those of the repository")
    parser.add_argument("--only", action="append", default=[], metavar="EFFECT=N")
    parser.add_argument("--check", action="store_true", help="a second record of each plant")
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args(arguments)
    recipes = records.committed() if given.committed else []
    wanted = [(kind, getattr(given, kind)) for kind in records.KINDS]
    wanted += [(name, int(count)) for name, count in (x.split("=") for x in given.only)]
    for kind, count in wanted:
        recipes += records.plan(kind, given.seed + len(recipes), count)
    seconds = make_all(recipes, given.out, given.check, given.processes)
    mean = sum(seconds.values()) / max(1, len(seconds))
    print(
        f"{len(seconds)} records in {given.out}, {mean:.2f} s each on average, "
        f"{max(seconds.values(), default=0.0):.2f} s at most"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
