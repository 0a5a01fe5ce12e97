# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A battery as data: which controllers, tasks, perturbations and searches, cut into units of work by index.

Two batteries with the same `to_mapping` do the same trials and give the same bytes. A unit is what a process does at a
time: a second or a few of one controller's trials. Which units there are depends on the battery alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

from puma_sim_core import __version__
from puma_sim_core.appraisal import controllers
from puma_sim_core.appraisal.controllers import Process
from puma_sim_core.appraisal.perturbations.drawing import (
    AUGMENTED,
    NOMINAL,
    RANDOM,
    Drawing,
    effect_names,
    names_of,
    split,
)
from puma_sim_core.appraisal.settings import PROFILES, Profile
from puma_sim_core.appraisal.tasks.library import Task, tasks
from puma_sim_core.checks import check_choice, check_whole
from puma_sim_core.effects import KINDS
from puma_sim_core.errors import ModelError, ParameterError
from puma_sim_core.plant.linkage.linkage_mechanism import LinkageMechanism
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.model_file import plant_of_mapping

BATTERY_FORMAT = "puma-sim battery 1"
#: controllers whose nominal trials tell whether the tasks mean something: it must fail each; it must pass each
FAILS_ALL, PASSES_ALL = "do_nothing", "computed_torque"
#: simulated time in a unit [s]; two masses in a joint count so many times
_UNIT, _TWO_MASSES = 40.0, 5.0


class Group(NamedTuple):
    """Trials of a task under a perturbation, all of its draws."""

    task: str
    perturbation: str
    draws: int


class Search(NamedTuple):
    """The search of the critical size of an effect, ``NAME:JOINT`` or ``NAME``, on draw number `draw` of the arm."""

    effect: str
    draw: int


class Unit(NamedTuple):
    """What a process does at a time."""

    number: int
    controller: str
    items: tuple[Group | Search, ...]
    control: bool = False


@dataclass(frozen=True)
class Battery:
    """What is appraised and how.

    controllers : names, see `controllers`; processes : those of them that are processes over topics.
    profile : one of `PROFILES`; seed : from which all draws follow.
    mechanism : name or file of the nominal arm; model : mapping of the augmented model's file, with its name, or None.
    tasks, perturbations : a selection by name, () for what the profile has; searches : whether critical sizes are
    sought.

    Raises ParameterError, ModelError: unknown or repeated names, an empty selection, a mechanism or model of another
    kind.
    """

    controllers: tuple[str, ...]
    profile: str = "standard"
    seed: int = 0
    mechanism: str = "puma560"
    model: Mapping[str, Any] | None = None
    tasks: tuple[str, ...] = ()
    perturbations: tuple[str, ...] = ()
    searches: bool = True
    processes: tuple[Process, ...] = ()

    def __post_init__(self) -> None:
        where = "appraise"
        check_choice(self.profile, "profile", PROFILES, where)
        check_whole(self.seed, "seed", 0, where=where)
        if not self.controllers:
            expected = f"one at least: module:Class, or one of {', '.join(controllers.BASELINES)}"
            raise ParameterError("no controller", where=where, expected=expected)
        for kind in ("controllers", "tasks", "perturbations"):
            names = getattr(self, kind)
            twice = [name for name in names if names.count(name) > 1]
            if twice:
                raise ParameterError(f"'{twice[0]}' stands twice", where=kind, expected="each once")
        own = {process.name for process in self.processes}
        for process in self.processes:
            process.check()
        for name in self.controllers:
            if name not in own:
                controllers.check_name(name)
        if left := own - set(self.controllers):
            expected = "each among the controllers"
            raise ParameterError(f"process '{min(left)}' is none of them", where="controllers", expected=expected)
        if "computed_torque_augmented" in self.controllers and self.model is None:
            expected = "--model FILE with it: the model that it knows"
            raise ParameterError("computed_torque_augmented without a model", where=where, expected=expected)
        known = tasks(self.setting.nominal)
        for name in self.tasks:
            check_choice(name, "task", known, where)
        self.groups  # noqa: B018  (refuses what cannot be selected)

    @property
    def settings(self) -> Profile:
        """Numbers of its profile."""
        return PROFILES[self.profile]

    @property
    def setting(self) -> Setting:
        """What its trials are made of, made once in a process."""
        return _setting(self.mechanism, _Frozen(self.model), self.seed)

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """All trials of a controller, in their order."""
        own, mechanism = self.settings, self.setting.drawing.mechanism
        every = self.tasks or tuple(self.setting.tasks)
        some = tuple(name for name in own.tasks if name in every) or every
        with_effects = tuple(name for name in own.effect_tasks if name in every) or some[:1]
        models = (NOMINAL,) if self.model is None else (NOMINAL, AUGMENTED)
        chosen = names_of(self.perturbations or (*models, *RANDOM, "effects"), mechanism)
        if AUGMENTED in chosen and self.model is None:
            raise ParameterError("perturbation 'augmented' without a model", expected="--model FILE with it")
        found = []
        for name in chosen:
            single = split(name)[1] is not None
            # the comparison of two models stands on arms drawn about both
            draws = 1 if single else own.draws if name in RANDOM or self.model is not None else 1
            where = every if name in models else with_effects if single else some
            found += [Group(task, name, draws) for task in where]
        return tuple(found)

    @cached_property
    def searched(self) -> tuple[Search, ...]:
        """Searches of critical sizes for a controller."""
        if not self.searches:
            return ()
        return tuple(
            Search(effect, draw)
            for effect in effect_names(self.setting.drawing.mechanism)
            for draw in range(self.settings.critical_draws)
        )

    @cached_property
    def units(self) -> tuple[Unit, ...]:
        """All work, the controls' first."""
        nominal = [Group(task, NOMINAL, 1) for task in dict.fromkeys(group.task for group in self.groups)]
        found: list[Unit] = []
        for name in (FAILS_ALL, PASSES_ALL):
            found += [Unit(0, name, items, True) for items in self._cut(nominal)]
        for name in self.controllers:
            found += [Unit(0, name, items) for items in self._cut([*self.groups, *self.searched])]
        return tuple(unit._replace(number=number) for number, unit in enumerate(found))

    def _cut(self, items: Sequence[Group | Search]) -> list[tuple[Group | Search, ...]]:
        """Items in parts of about `_UNIT` simulated seconds."""
        parts: list[tuple[Group | Search, ...]] = []
        part: list[Group | Search] = []
        size = 0.0
        for item in items:
            part.append(item)
            size += self._cost(item)
            if size >= _UNIT:
                parts.append(tuple(part))
                part, size = [], 0.0
        return [*parts, tuple(part)] if part else parts

    def _cost(self, item: Group | Search) -> float:
        """Simulated time of an item [s], weighted."""
        if isinstance(item, Search):
            base, runs, time = item.effect, self.settings.bisections + 2, self.setting.tasks["effects"].duration
        else:
            base, runs = split(item.perturbation)[0], item.draws
            time = self.setting.tasks[item.task].duration
        kind = KINDS.get(base.partition(":")[0])
        return runs * time * (_TWO_MASSES if kind is not None and kind.two_masses else 1.0)

    def to_mapping(self) -> dict[str, Any]:
        """Plain values that say what the battery is."""
        return {
            "format": BATTERY_FORMAT,
            "version": __version__,
            "controllers": list(self.controllers),
            "profile": self.profile,
            "seed": self.seed,
            "mechanism": self.mechanism,
            "model": None if self.model is None else dict(self.model),
            "tasks": list(self.tasks),
            "perturbations": list(self.perturbations),
            "searches": self.searches,
            "processes": [process._asdict() for process in self.processes],
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> Battery:
        """The inverse of `to_mapping`, of a mapping that may have more; raises ParameterError."""
        found = mapping.get("format")
        if found != BATTERY_FORMAT:
            raise ParameterError(f"format {found!r}", where=where, expected=f"'{BATTERY_FORMAT}'")
        if mapping.get("version") != __version__:
            what = f"it was begun by version {mapping.get('version')}"
            raise ParameterError(what, where=where, expected=f"one of version {__version__}, or another folder")
        lacking = [one.name for one in fields(cls) if one.name not in mapping]
        if lacking:
            raise ParameterError(f"it has no {lacking[0]}", where=where, expected="all that a battery is made of")
        values = {one.name: mapping[one.name] for one in fields(cls)}
        for name in ("controllers", "tasks", "perturbations"):
            values[name] = tuple(values[name])
        values["processes"] = tuple(Process(**each) for each in values["processes"])
        return cls(**values)


@dataclass(frozen=True)
class Setting:
    """What trials are made of: the nominal plant, draws about it, tasks, and what controllers know."""

    nominal: Any
    drawing: Drawing
    tasks: dict[str, Task]
    models: controllers.Models


class _Frozen:
    """A mapping as a key of a cache: equal where its text is."""

    def __init__(self, mapping: Mapping[str, Any] | None):
        self.mapping = mapping
        self._text = repr(mapping)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Frozen) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)


@lru_cache(maxsize=4)
def _setting(mechanism: str, model: _Frozen, seed: int) -> Setting:
    base = load_mechanism(mechanism)
    if isinstance(base, LinkageMechanism):
        what = f"a mechanism of kind {base.body.kind} with {base.joints} joint{'s' * (base.joints > 1)}"
        raise ParameterError(what, where=mechanism, expected="one of kind arm: tasks and measures are at its wrist")
    augmented = None if model.mapping is None else _augmented(base, model.mapping)
    plant: Any = base.plant()
    known = controllers.Models(plant, None if augmented is None else augmented.plant())
    try:
        made = tasks(plant)
    except ParameterError as error:
        expected = "an arm of the PUMA 560's size, whose wrist reaches the paths of `puma-sim appraise list`"
        raise ParameterError(f"a task cannot be done: {error}", where=mechanism, expected=expected) from None
    return Setting(plant, Drawing(base, augmented, seed), made, known)


def _augmented(base: Mechanism, mapping: Mapping[str, Any]) -> Mechanism:
    plant = plant_of_mapping(mapping, "--model")
    if plant.joints != base.joints:
        what = f"a model of {plant.joints} joint{'s' * (plant.joints > 1)}"
        raise ModelError(what, where="--model", expected=f"one of {base.name}, of {base.joints} joints")
    return base.of_plant(plant)
