# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A bag's commands through the core again: the same states to the last bit, or the first that
differs."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from puma_sim_core.errors import BagError, CommandError, ModelError, NonFiniteStateError, ParameterError
from puma_sim_core.files import parse_yaml
from puma_sim_core.jit import BACKEND
from puma_sim_core.recording.bag import read_bag
from puma_sim_core.simulation.session import Session, SessionConfig

_COMPARED = ("position", "velocity", "current", "voltage", "effort")
_UNITS = {"position": "rad", "velocity": "rad/s", "current": "A", "voltage": "V", "effort": "N.m"}


@dataclass(frozen=True)
class Replay:
    """What a replay found.

    Attributes
    ----------
    steps : steps that were compared, state 0 not counted.
    commands : commands that were given again.
    first_difference : a sentence on the first step that differs, None where all bits agree.
    greatest_difference : of the positions over all steps [rad].
    recorded_version, recorded_kernel : what wrote the bag.
    """

    steps: int
    commands: int
    first_difference: str | None
    greatest_difference: float
    recorded_version: str
    recorded_kernel: str

    @property
    def identical(self) -> bool:
        """Whether every position, velocity, current, voltage and effort has the same bits."""
        return self.first_difference is None


def session_of(path: str | os.PathLike, config_text: str) -> tuple[SessionConfig, dict]:
    """The session that a bag's model text describes, with its mapping.

    Raises
    ------
    BagError : a model that this version cannot rebuild; names what and the recorder's version.
    """
    where = f"{path}: topic sim_node/model"
    mapping = parse_yaml(config_text, where, BagError)
    try:
        return SessionConfig.from_mapping(mapping, where), mapping
    except (ModelError, ParameterError) as error:
        version = mapping.get("version", "?") if isinstance(mapping, dict) else "?"
        raise BagError(
            f"the model cannot be rebuilt: {error.what}",
            where=f"{error.where or where} (recorded by version {version})",
            expected=error.expected,
        ) from None


def replay(path: str | os.PathLike) -> Replay:
    """Run a bag's commands through the core and compare.

    path : the bag's directory or its .mcap file.

    Raises
    ------
    BagError : no bag of this simulator, a truncated one, or a model that cannot be rebuilt.
    """
    bag = read_bag(path)
    config, mapping = session_of(path, bag.config_text)
    session = Session(config)
    commands = list(bag.commands)
    states = [session.state]
    given, problem = 0, None
    for step in range(len(bag.steps) - 1):
        while given < len(commands) and commands[given][0] == step:
            names, values = commands[given][1]
            try:
                if names is None:
                    session.command(values)
                else:
                    session.command_joints(names, values)
            except CommandError as error:
                raise BagError(
                    f"its session refuses a command: {error.what}",
                    where=f"{path}: step {step}",
                    expected=error.expected,
                ) from None
            given += 1
        try:
            states.append(session.step())
        except NonFiniteStateError as error:
            problem = str(error)
            break
    difference, greatest = _compare(bag, states)
    return Replay(
        steps=len(bag.steps) - 1,
        commands=given,
        first_difference=difference or problem,
        greatest_difference=greatest,
        recorded_version=str(mapping.get("version", "?")),
        recorded_kernel=str(mapping.get("kernel", "?")),
    )


def _compare(bag, states) -> tuple[str | None, float]:
    """The first difference in bits as a sentence, and the greatest one in position [rad]."""
    first = None
    n = len(states)
    for name in _COMPARED:
        ours = np.array([getattr(state, name) for state in states])
        theirs = getattr(bag, name)[:n]
        # compared as integers: -0.0 differs from 0.0
        differs = ours.view(np.int64) != np.ascontiguousarray(theirs).view(np.int64)
        rows = np.flatnonzero(differs.any(axis=1))
        if rows.size and (first is None or rows[0] < first[0]):
            r = int(rows[0])
            j = int(np.flatnonzero(differs[r])[0])
            first = (
                r,
                f"step {r} ({bag.time_ns[r] * 1e-9:.3f} s): {name} of joint {j + 1} was "
                f"{float(theirs[r, j])!r} and is {float(ours[r, j])!r} {_UNITS[name]}",
            )
    greatest = float(np.abs(np.array([s.position for s in states]) - bag.position[:n]).max())
    if first is None:
        return None, greatest
    kernel = f"; this process runs the {BACKEND} kernel"
    return first[1] + kernel, greatest
