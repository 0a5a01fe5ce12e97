# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A bag's inputs through the core again: the same states to the last bit, or the first that differs."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from puma_sim_core.errors import BagError, CommandError, ModelError, NonFiniteStateError, ParameterError
from puma_sim_core.files import parse_yaml
from puma_sim_core.jit import kernel_in_use
from puma_sim_core.plant.plant import effects_of_mapping
from puma_sim_core.recording.bag import (
    BagContents,
    RecordedBrakes,
    RecordedCommand,
    RecordedEffects,
    RecordedPlacement,
    read_bag,
)
from puma_sim_core.simulation.session import Session, SessionState
from puma_sim_core.simulation.session_config import SessionConfig

_UNITS = {"position": "rad", "velocity": "rad/s", "current": "A", "voltage": "V", "effort": "N.m"}


@dataclass(frozen=True)
class Replay:
    """What a replay found.

    steps : steps that were compared, state 0 not counted; commands : commands that were given again.
    missing : (first, last) step of those that the bag lacks, and where the comparison ends; None where none lacks.
    first_difference : a sentence on the first step that differs, None where all bits agree.
    greatest_difference : of the positions over all steps [rad].
    recorded_version, recorded_kernel : what wrote the bag.
    """

    steps: int
    commands: int
    missing: tuple[int, int] | None
    first_difference: str | None
    greatest_difference: float
    recorded_version: str
    recorded_kernel: str

    @property
    def identical(self) -> bool:
        """Whether every position, velocity, current, voltage and effort has the same bits."""
        return self.first_difference is None


def session_of(path: str | os.PathLike[str], config_text: str) -> tuple[SessionConfig, dict[str, Any]]:
    """The session that a bag's model text describes, with its mapping.

    Raises BagError: a model that this version cannot rebuild; names what and the recorder's version.
    """
    where = f"{path}: topic sim_node/model"
    mapping = parse_yaml(config_text, where, BagError)
    try:
        return SessionConfig.from_mapping(mapping, where), mapping
    except (ModelError, ParameterError) as error:
        version = mapping.get("version", "?") if isinstance(mapping, dict) else "?"
        place = f"{error.where or where} (recorded by version {version})"
        raise BagError(f"the model cannot be rebuilt: {error.what}", where=place, expected=error.expected) from None


def replay(path: str | os.PathLike[str]) -> Replay:
    """Run a bag's commands through the core and compare.

    path : the bag's directory or its .mcap file.

    Raises BagError: no bag of this simulator, a truncated one, or a model that cannot be rebuilt.
    """
    bag = read_bag(Path(path))
    config, mapping = session_of(path, bag.config_text)
    session = Session(config)
    missing = bag.missing[0] if bag.missing else None
    last = missing[0] - 1 if missing else len(bag.steps) - 1
    inputs = iter([*bag.inputs, (-1, None)])
    at, given = next(inputs)
    states, commands, problem = [session.state], 0, None
    for step in range(last):
        while at == step:
            commands += isinstance(given, RecordedCommand)
            _give(session, given, f"{path}: step {step}")
            at, given = next(inputs)
        try:
            states.append(session.step())
        except NonFiniteStateError as error:
            problem = str(error)
            break
    difference, greatest = _compare(bag, states)
    return Replay(
        steps=last,
        commands=commands,
        missing=missing,
        first_difference=difference or problem,
        greatest_difference=greatest,
        recorded_version=str(mapping.get("version", "?")),
        recorded_kernel=str(mapping.get("kernel", "?")),
    )


def _give(session: Session, given: object, where: str) -> None:
    """Give one input of a bag to a session again."""
    try:
        match given:
            case RecordedCommand(None, values):
                session.command(values)
            case RecordedCommand(names, values) if names is not None:
                session.command_joints(names, values)
            case RecordedPlacement(names, position, velocity):
                session.place(names, position, velocity)
            case RecordedBrakes(engaged):
                session.brake(engaged)
            case RecordedEffects(text):
                session.use_effects(effects_of_mapping({"effects": parse_yaml(text, where, BagError)}))
    except (CommandError, ParameterError) as error:
        what = f"its session refuses an input: {error.what}"
        raise BagError(what, where=where, expected=error.expected) from None


def _compare(bag: BagContents, states: list[SessionState]) -> tuple[str | None, float]:
    """The first difference in bits as a sentence, and the greatest one in position [rad]."""
    first: tuple[int, str] | None = None
    n = len(states)
    for name, unit in _UNITS.items():
        ours = np.array([getattr(state, name) for state in states])
        theirs = np.ascontiguousarray(getattr(bag, name)[:n])
        # compared as integers: -0.0 differs from 0.0
        places = np.argwhere(ours.view(np.int64) != theirs.view(np.int64))
        if len(places) and (first is None or places[0, 0] < first[0]):
            r, j = (int(place) for place in places[0])
            was, now = float(theirs[r, j]), float(ours[r, j])
            where = f"step {r} ({bag.time_ns[r] * 1e-9:.3f} s)"
            first = (r, f"{where}: {name} of joint {j + 1} was {was!r} and is {now!r} {unit}")
    greatest = float(np.abs(np.array([s.position for s in states]) - bag.position[:n]).max())
    return None if first is None else f"{first[1]}; this process runs the {kernel_in_use()} kernel", greatest
