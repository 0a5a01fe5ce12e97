# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What differs from the nominal arm in a trial: drawn once, and shared by all controllers.

A perturbation has a name, such as ``nominal`` or ``coulomb_friction:2:large``. `conditions` makes of it what one draw
is like: the draw follows from the seed, the name and its number alone, so that all controllers meet the same, in any
order and on any number of processes.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.appraisal.perturbations.sizes import SIZES, effect_of_size, scalable
from puma_sim_core.checks import check_choice
from puma_sim_core.effects import Effect, parse_effect
from puma_sim_core.errors import ParameterError, one_of
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.plant import Plant

#: random perturbations, with what they are
RANDOM = {
    "parameters": "masses, inertias, motor constants and viscous friction, from the priors of the mechanism",
    "payload": "a load of 0 to 2.5 kg at the wrist, the arm's rated one",
    "noise": "white noise on the measured positions, 0.02 to 0.2 mrad",
    "quantisation": "encoders of 250 to 1000 counts a motor turn, converters of 8 to 12 bits",
    "delay": "voltages 0.5 to 5 ms late",
    "jitter": "each voltage late by a time of its own, up to 1 to 5 ms",
    "dropped": "1 to 10 % of the voltages do not arrive; the last one stays",
    "pulses": "pushes of 5 to 60 N.m for 20 to 150 ms, one on each joint",
    "all": "all of these together, and dry friction",
}
NOMINAL, AUGMENTED = "nominal", "augmented"


@dataclass(frozen=True)
class Conditions:
    """What one trial is like.

    plant : the arm and its effects; encoder_counts a motor turn and converter_bits: None for ideal ones.
    noise : standard deviation of the measured positions [rad]; jitter : greatest extra delay of a voltage [s];
    dropped : share of the voltages that do not arrive; stream : seeds of what is random in the course of the trial.
    """

    plant: Plant
    encoder_counts: int | None = None
    converter_bits: int | None = None
    noise: float = 0.0
    jitter: float = 0.0
    dropped: float = 0.0
    stream: tuple[int, ...] = (0,)

    @property
    def compiled(self) -> bool:
        """Whether the kernel alone can run a servo under them."""
        return not (self.noise or self.jitter or self.dropped)


def effect_names(mechanism: Mechanism) -> list[str]:
    """Perturbations of single effects, ``NAME:JOINT`` or ``NAME``, without their sizes."""
    found = []
    for kind in scalable():
        if mechanism.possible(kind.name):
            found += [f"{kind.name}:{j}" for j in (1, 2, 3)] if kind.per_joint else [kind.name]
    return found


def split(name: str) -> tuple[str, str | None]:
    """(name without its size, size) of the perturbation of a single effect; (name, None) of another."""
    base, _, size = name.rpartition(":")
    return (base, size) if size in SIZES else (name, None)


def single_effect(base: str, size: float, middle: float) -> Effect:
    """The effect of ``NAME:JOINT`` or ``NAME`` at a size 0 to 1 of its plausible range; see `effect_of_size`."""
    name, _, joint = base.partition(":")
    return effect_of_size(name, int(joint) if joint else None, size, middle)


@dataclass(frozen=True)
class Drawing:
    """What draws are made of: the mechanism (its start is the nominal arm), the augmented one, and the seed."""

    mechanism: Mechanism
    augmented: Mechanism | None
    seed: int

    def conditions(self, name: str, draw: int, middle: float) -> Conditions:
        """Conditions of draw number `draw` of a perturbation; middle : of the trial [s], where what happens once does.

        Raises ParameterError: a name that is none.
        """
        base, size = split(name)
        stream = (self.seed, zlib.crc32(name.encode()), draw)
        if size is not None:
            return Conditions(self.with_effect(base, SIZES[size], middle), stream=stream)
        if base in (NOMINAL, AUGMENTED):
            # draw 0 is the model itself; behind it come arms about it, the same for both models
            rng = np.random.default_rng((self.seed, zlib.crc32(b"models"), draw))
            mechanism = self._mechanism(base)
            return Conditions(_drawn(mechanism, rng) if draw else mechanism.plant(), stream=stream)
        check_choice(base, "perturbation", (NOMINAL, AUGMENTED, *RANDOM))
        return self._random(base, np.random.default_rng(stream), middle, stream)

    def _mechanism(self, name: str) -> Mechanism:
        if name == NOMINAL:
            return self.mechanism
        if self.augmented is None:
            raise ParameterError("no augmented model", where=f"perturbation {name}", expected="--model FILE with it")
        return self.augmented

    def with_effect(self, base: str, size: float, middle: float, draw: int = 0) -> Plant:
        """The nominal plant, or draw number `draw` about it, with one effect of a size; see `single_effect`."""
        rng = np.random.default_rng((self.seed, zlib.crc32(b"models"), draw))
        plant = _drawn(self.mechanism, rng) if draw else self.mechanism.plant()
        return _with(plant, [single_effect(base, size, middle)])

    def _random(self, name: str, rng: np.random.Generator, middle: float, stream: tuple[int, ...]) -> Conditions:
        every = name == "all"
        found = Conditions(_drawn(self.mechanism, rng) if every or name == "parameters" else self.mechanism.plant())
        effects: list[Effect] = []
        if every or name == "payload":
            effects.append(parse_effect(f"payload:mass={rng.uniform(0.0, 2.5)!r}"))
        if every:
            scale = self.mechanism.torque_scale
            levels = rng.uniform(0.2, 1.0, 3) * scale
            effects += [
                parse_effect(f"coulomb_friction:joint={j},torque={f!r}") for j, f in enumerate(levels.tolist(), 1)
            ]
        if every or name == "noise":
            found = replace(found, noise=_log_uniform(rng, 2e-5, 2e-4))
        if every or name == "quantisation":
            bits = int(rng.integers(8, 13))
            found = replace(found, encoder_counts=int(rng.integers(250, 1001)), converter_bits=bits)
        if every or name == "delay":
            effects.append(parse_effect(f"input_delay:time={_log_uniform(rng, 5e-4, 5e-3)!r}"))
        if every or name == "jitter":
            found = replace(found, jitter=_log_uniform(rng, 1e-3, 5e-3))
        if every or name == "dropped":
            found = replace(found, dropped=_log_uniform(rng, 0.01, 0.1))
        if every or name == "pulses":
            effects += _pulses(rng, middle)
        return replace(found, plant=_with(found.plant, effects), stream=stream)


def _drawn(mechanism: Mechanism, rng: np.random.Generator) -> Plant:
    """The plant with parameters from their priors, cut off at two and a half deviations: an arm must stay one."""
    away = np.clip(rng.standard_normal(len(mechanism.start)), -2.5, 2.5)
    return mechanism.plant(mechanism.start + away * mechanism.deviations)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.uniform())


def _pulses(rng: np.random.Generator, middle: float) -> list[Effect]:
    made = []
    for joint in (1, 2, 3):
        torque = _log_uniform(rng, 5.0, 60.0) * (1.0 if rng.uniform() < 0.5 else -1.0)
        at, width = middle * rng.uniform(0.7, 1.3), _log_uniform(rng, 0.02, 0.15)
        made.append(parse_effect(f"impulse:joint={joint},torque={torque!r},time={at!r},width={width!r}"))
    return made


def _with(plant: Plant, effects: Iterable[Effect]) -> Plant:
    """The plant with effects, in place of those of the same kind that it has already."""
    effects = tuple(effects)
    named = {(effect.kind.name, effect.joint) for effect in effects}
    kept = tuple(effect for effect in plant.effects if (effect.kind.name, effect.joint) not in named)
    return replace(plant, effects=kept + effects)


def names_of(selection: Sequence[str], mechanism: Mechanism) -> list[str]:
    """Full names of perturbations: ``effects`` becomes each effect at each size; the others stay."""
    known = (NOMINAL, AUGMENTED, *RANDOM)
    found = []
    for name in selection:
        base, size = split(name)
        if name == "effects":
            found += [f"{each}:{one}" for each in effect_names(mechanism) for one in SIZES]
        elif name in known or (size is not None and base in effect_names(mechanism)):
            found.append(name)
        else:
            expected = f"effects, EFFECT:JOINT:SIZE, or {one_of(name, known, '`puma-sim appraise list`')}"
            raise ParameterError(f"unknown perturbation '{name}'", expected=expected)
    return list(dict.fromkeys(found))
