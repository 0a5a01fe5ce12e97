# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Trials of a battery once more: the same bits, for figures and for bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.appraisal import controllers
from puma_sim_core.appraisal.battery import Battery, Group
from puma_sim_core.appraisal.settings import VOLTAGE_LIMIT, Patience
from puma_sim_core.appraisal.trials.guard import Watched, in_child
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.appraisal.trials.trial import Trial, run_trial
from puma_sim_core.appraisal.work import conditions_of
from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.files import yaml_text
from puma_sim_core.recording.bag import BagRecorder
from puma_sim_core.simulation.session import Session
from puma_sim_core.simulation.session_config import SessionConfig

#: commands after which a trial that is done in a process of its own tells them
_TOLD = 300


class Again(NamedTuple):
    """A trial that was done again: its response, and what the plant was given: (n, 3) [V], a row each `step` [s]."""

    response: Response | None
    commands: np.ndarray
    step: float


def again(battery: Battery, name: str, group: Group, draw: int, patience: Patience = Patience()) -> Again:
    """A trial of a controller once more; a controller of the user's in a process of its own.

    Where that dies, or says nothing, there is no response, and commands up to some samples before then. Of a process
    over topics, which is not met here, there is nothing.
    """
    if name in {process.name for process in battery.processes}:
        return Again(None, np.empty((0, 3)), controllers.PERIOD)
    setting, conditions = battery.setting, conditions_of(battery, group, draw)
    task, arm = setting.tasks[group.task], setting.nominal.arm
    if not controllers.is_foreign(name):
        made = controllers.make(name, setting.models)
        trial = Trial(task, conditions, arm, made.period)
        response = run_trial(trial, made)
        return Again(response, trial.commands(), trial.step)

    def work(send: Callable[[Any], None]) -> None:
        watched = Watched(controllers.make(name, setting.models).controller, patience)
        trial = Trial(task, conditions, arm, watched.period)
        send(trial.step)
        told = _Telling(watched, trial, send)
        send((trial.run(told), trial.commands()))

    sent, _ = in_child(work, patience.start + patience.trial)
    if sent and isinstance(sent[-1], tuple):
        response, commands = sent[-1]
        return Again(response, commands, sent[0])
    step = sent[0] if sent else controllers.PERIOD
    return Again(None, np.vstack([np.empty((0, 3)), *sent[1:]]), step)


class _Telling:
    """A controller whose commands, as the plant was given them, are sent before each answer that may be the last."""

    def __init__(self, controller: Watched, trial: Trial, send: Callable[[Any], None]):
        self.period = controller.period
        self._controller, self._trial, self._send, self._sent = controller, trial, send, 0

    def reset(self) -> None:
        self._controller.reset()

    def update(self, t: float, setpoint: Any, measurement: Any) -> Any:
        given = self._trial.rows_given
        if given - self._sent >= _TOLD:
            self._send(self._trial.commands(self._sent))
            self._sent = given
        return self._controller.update(t, setpoint, measurement)


def write_bag(path: Path, battery: Battery, group: Group, draw: int, trial: Again) -> None:
    """Record a trial as a session in volts, with the arm, its effects and the commands: `puma-sim replay` checks it.

    Raises BagError: the bag exists, or cannot be written.
    """
    task = battery.setting.tasks[group.task]
    greatest = float(np.abs(trial.commands).max(initial=VOLTAGE_LIMIT))
    config = SessionConfig(
        conditions_of(battery, group, draw).plant,
        period=trial.step,
        substeps=1,
        voltage_limit=greatest,
        command_timeout=0.0,
        initial_position=task.start,
    )
    session = Session(config)
    with BagRecorder(
        path,
        config_text=yaml_text(config.to_mapping()),
        joint_names=config.joint_names,
        frame_id=config.frame_id,
        command_interface=config.command_interface,
        period_ns=config.period_ns,
    ) as bag:
        bag.write_state(session.state)
        for volts in trial.commands.tolist():
            bag.write_command(session.state.time_ns, session.command(volts))
            try:
                bag.write_state(session.step())
            except NonFiniteStateError:
                break
