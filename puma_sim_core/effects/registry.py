# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The registry of effects: those of this folder, and users' own.

These come from entry points of the group ``puma_sim.effects``, from the files that the environment variable
PUMA_SIM_EFFECTS names (separated as PATH is), or from `load_effects`, before the kernel is built from the registry.
"""

import copyreg
import importlib
import importlib.util
import os
import pkgutil
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from puma_sim_core.effects.base import Effect, Kind, LookAlike, Point, Stage
from puma_sim_core.effects.relations import ALIKE_IN_PART, CONTAINS, LOOK_ALIKES
from puma_sim_core.errors import ParameterError, one_of
from puma_sim_core.jit import add_source

#: environment variable with the files of users' own effects
VARIABLE = "PUMA_SIM_EFFECTS"
_GROUP = "puma_sim.effects"
#: files of users' own effects that are registered
_LOADED: set[str] = set()
_NOT_EFFECTS = ("base", "registry", "relations", "screening", "shared")


def _own() -> Iterator[Kind]:
    """The effects of this folder."""
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        if module.name not in _NOT_EFFECTS:
            kind = importlib.import_module(f"puma_sim_core.effects.{module.name}").EFFECT
            if kind.name != module.name:
                raise ParameterError(f"effect {kind.name}", where=f"effects/{module.name}.py", expected=module.name)
            yield kind


def _resolved(path: str | os.PathLike[str]) -> str:
    return str(Path(path).expanduser().resolve())


def _of_file(path: str | os.PathLike[str]) -> Kind:
    """The effect of a user's file."""
    where, file = f"effect file {path}", Path(_resolved(path))
    spec = importlib.util.spec_from_file_location(f"puma_sim_effect_{file.stem}", file)
    if spec is None or spec.loader is None or not file.is_file():
        raise ParameterError("cannot be read", where=where, expected="a Python file with EFFECT")
    module = importlib.util.module_from_spec(spec)
    # functions that are compiled are looked up by the name of their module
    sys.modules[spec.name] = module
    add_source(file)
    with _importing(where, "a file that can be imported"):
        spec.loader.exec_module(module)
    return _checked(getattr(module, "EFFECT", None), where)


@contextmanager
def _importing(where: str, expected: str) -> Iterator[None]:
    """Errors of a user's module as ParameterErrors."""
    try:
        yield
    except ParameterError:
        raise
    except Exception as error:
        raise ParameterError(f"{type(error).__name__}: {error}", where=where, expected=expected) from error


def _checked(kind: Any, where: str) -> Kind:
    if not isinstance(kind, Kind):
        raise ParameterError(f"EFFECT is {type(kind).__name__}", where=where, expected="EFFECT = Kind(...)")
    if not kind.name.isidentifier() or not kind.parameters:
        raise ParameterError(f"name '{kind.name}'", where=where, expected="an identifier, and at least one parameter")
    if kind.per_joint and {law.point for law in kind.laws} & {Point.ARM_TORQUE, Point.SUPPLY_SHARE, Point.DELAY}:
        raise ParameterError("a law of the whole arm", where=where, expected="per_joint=False with it")
    return kind


def _of_entry_points() -> Iterator[Kind]:
    for entry in entry_points(group=_GROUP):
        where = f"entry point {entry.name}"
        with _importing(where, "an importable effect"):
            found = entry.load()
        file = getattr(sys.modules.get(entry.module), "__file__", None)
        if file:
            add_source(Path(file))
        yield _checked(getattr(found, "EFFECT", found), where)


def _from_environment() -> Iterator[Kind]:
    for path in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        _LOADED.add(_resolved(path))
        yield _of_file(path)


def _related(kinds: list[Kind]) -> dict[str, Kind]:
    """Effects by name, in order, with the look-alikes and special cases of both sides, and with those that a joint may
    have several of."""
    kinds = [each for kind in kinds if kind.number == 1 for each in (kind, *kind.further)]
    found = {kind.name: kind for kind in sorted(kinds, key=lambda kind: kind.order)}
    for name, count in Counter(kind.name for kind in kinds).items():
        if count > 1:
            raise ParameterError(f"effect {name} is defined twice", expected="each name once")
    pairs = list(LOOK_ALIKES)
    firsts = [kind for kind in found.values() if kind.number == 1]
    pairs += [(kind.name, pair.other, pair.mine, pair.its) for kind in firsts for pair in kind.look_alikes]
    table: dict[str, list[LookAlike]] = {name: [] for name in found}
    seen: set[frozenset[str]] = set()
    for one, other, mine, its in pairs:
        # an effect that is related already states its pairs from its own side
        if one in found and other in found and frozenset((one, other)) not in seen:
            seen.add(frozenset((one, other)))
            table[one].append(LookAlike(other, mine, its))
            table[other].append(LookAlike(one, its, mine))
    return {
        name: replace(
            kind,
            look_alikes=tuple(table[kind.first]),
            contains=CONTAINS.get(kind.first, kind.contains),
            alike_in_part=ALIKE_IN_PART.get(kind.first, kind.alike_in_part),
        )
        for name, kind in found.items()
    }


KINDS: dict[str, Kind] = _related([*_own(), *_of_entry_points(), *_from_environment()])

_PLACES: dict[str, int] = {}
_NEUTRAL: list[float] = []
#: parameters of one joint in the packed table
WIDTH = 0


def _place() -> None:
    global WIDTH
    _PLACES.clear()
    _NEUTRAL.clear()
    for kind in KINDS.values():
        _PLACES[kind.name] = len(_NEUTRAL)
        _NEUTRAL.extend(p.neutral for p in kind.parameters)
    WIDTH = len(_NEUTRAL)


_place()


def load_effects(paths: Iterable[str | os.PathLike[str]]) -> None:
    """Register users' own effects from files; processes that are started from here on know them too.

    Raises
    ------
    ParameterError : a file without a usable ``EFFECT``, a name twice, or a kernel that has been built already.
    """
    files = [file for file in dict.fromkeys(map(_resolved, paths)) if file not in _LOADED]
    if not files:
        return
    if "puma_sim_core.dynamics.laws" in sys.modules:
        expected = "to be loaded before anything is simulated: the kernel is built"
        raise ParameterError(f"effects of {', '.join(files)}", expected=expected)
    combined = _related([*KINDS.values(), *map(_of_file, files)])
    KINDS.clear()
    KINDS.update(combined)
    _place()
    _LOADED.update(files)
    os.environ[VARIABLE] = os.pathsep.join(filter(None, [os.environ.get(VARIABLE), *files]))


def named(name: str) -> Kind:
    """The effect of a name."""
    return KINDS[name]


# by its name: its functions cannot go to another process
copyreg.pickle(Kind, lambda kind: (named, (kind.name,)))


def slot(kind: Kind) -> int:
    """Place of the first parameter of `kind` among the parameters of a joint."""
    return _PLACES[kind.name]


def laws(point: Point) -> list[tuple[Callable[..., Any], int]]:
    """(function, place of its effect's first parameter) of the laws at a point, in their order."""
    found = [(law, slot(kind)) for kind in KINDS.values() for law in kind.laws if law.point is point]
    return [(law.function, place) for law, place in sorted(found, key=lambda each: each[0].order)]


def memories() -> list[tuple[Callable[..., Any], Callable[..., Any], int]]:
    """(follow, torque, place) of the effects with a deflection of their own."""
    return [(*kind.memory, _PLACES[kind.name]) for kind in KINDS.values() if kind.memory is not None]


def parse_effect(text: str) -> Effect:
    """The effect written as ``name:joint=2,parameter=value,...``.

    Raises
    ------
    ParameterError : names the part of the text that cannot be used.
    """
    where = f"effect '{text}'"
    name, _, rest = text.strip().partition(":")
    if name not in KINDS:
        raise ParameterError(f"unknown effect '{name}'", where=where, expected=one_of(name, KINDS, "`puma-sim list`"))
    values: dict[str, float] = {}
    for item in filter(None, rest.split(",")):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not key or not value:
            raise ParameterError(f"'{item}'", where=where, expected="key=value")
        if key in values:
            raise ParameterError(f"'{key}' is given twice", where=where, expected="each once")
        try:
            values[key] = int(value) if key == "joint" else float(value)
        except ValueError:
            expected = "joint=1, 2 or 3" if key == "joint" else "a number"
            raise ParameterError(f"{key}={value}", where=where, expected=expected) from None
    joint = values.pop("joint", None)
    return Effect(KINDS[name], None if joint is None else int(joint), values)


def distinct(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """The effects, each name once a joint: of those that a joint may have several of, the next free name is taken.

    Raises
    ------
    ParameterError : an effect stands more often on one joint than there may be of it.
    """
    found: dict[tuple[str, int | None], Effect] = {}
    for effect in effects:
        kind, joint = effect.kind, effect.joint
        name = next((name for name in (kind.name, *kind.names) if (name, joint) not in found), None)
        if name is None:
            place = "the arm" if joint is None else f"joint {joint}"
            what = f"effect {kind.first} stands {'twice' if kind.most == 1 else 'too often'} on {place}"
            most = "once" if kind.most == 1 else f"at most {kind.most} times"
            raise ParameterError(what, expected=f"each kind {most} a joint")
        found[name, joint] = effect if name == kind.name else Effect(KINDS[name], joint, effect.values)
    return tuple(found.values())


def pack(effects: Iterable[Effect]) -> list[float]:
    """The flat table of 3 * WIDTH parameters that the kernel reads."""
    table = _NEUTRAL * 3
    for effect in effects:
        joints = (0, 1, 2) if effect.joint is None else (effect.joint - 1,)
        for j in joints:
            at = j * WIDTH + slot(effect.kind)
            table[at : at + len(effect.values)] = effect.values.values()
    return table


def fill_arm(table: list[float], kind: Kind, numbers: Iterable[float]) -> None:
    """Put numbers that an effect of the whole arm comes down to in its places, joint by joint, in a table of `pack`."""
    width = len(kind.parameters)
    for n, number in enumerate(numbers):
        table[n // width * WIDTH + slot(kind) + n % width] = float(number)


def vanishes(effect: Effect) -> bool:
    """Whether the effect, as it stands, leaves link and motor one."""
    return effect.kind.vanishes is not None and effect.kind.vanishes(effect.values)


def active_stages(effects: Iterable[Effect]) -> int:
    """Bit mask of the kernel's optional stages that these effects need."""
    effects, mask = tuple(effects), 0
    bristled = {effect.joint for effect in effects if effect.kind.has_bristle}
    for effect in effects:
        # a joint whose dry friction acts through a bristle never sticks and slips
        mask |= effect.kind.stage & (~int(Stage.DRY) if effect.joint in bristled else -1)
    return mask
