# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A controller that is a process over topics, with the interface of a controller object."""

from collections.abc import Callable, Sequence
from math import isfinite

import numpy as np

from puma_sim_core.appraisal.controllers import Process
from puma_sim_core.appraisal.settings import ROWS
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.appraisal.trials.trial import Ending, Trial
from puma_sim_core.servo.pid import Pid
from puma_sim_core.simulation.feedback import Controller
from puma_sim_ros.appraisal.command import Running, words_of
from puma_sim_ros.appraisal.topics import Topics


class Foreign:
    """A process, started when it is needed and again where it has failed.

    `controller` is what a trial is run with: this object, or with the interface position a digital servo behind it.
    """

    def __init__(self, process: Process, topics: Topics, servo: Callable[[], Pid]) -> None:
        self.process, self.period, self._topics = process, process.period, topics
        self._words = words_of(process.command, f"parameter '{process.name}.command'")
        self._running: Running | None = None
        self._reference = np.zeros((1, 3))
        self.controller: Controller = self if process.interface == "voltage" else Servoed(self, servo())

    def run(self, trial: Trial, controller: Controller | None = None) -> Response:
        """The trial with the process; controller : what it is run with, `controller` by default."""
        self._reference = trial.reference[:: trial.per_setpoint]
        response = trial.run(controller or self.controller)
        if self._running is not None and (why := self._topics.objection()) and not response.failed:
            trial.fail("refused", why)
            response = trial.response()
        if response.end in ("late", "died", "refused"):
            # its next answers would be those of this trial; one that has only broken a rule can still end by itself
            self.stop(polite=response.end == "refused")
        return response

    def start(self) -> None:
        """Start the process and wait until it answers, unless it runs; raises Ending."""
        if self._running is not None:
            return
        self._topics.listen(self.process.interface)
        self._running = Running(self._words)
        try:
            self._topics.connect(self._reference, self._running.ended)
        except Ending as ending:
            said = self._running.last_line
            self.stop(polite=False)
            raise Ending(ending.end, f"{ending}, and said last: {said}" if said else str(ending)) from None

    def stop(self, polite: bool = True) -> None:
        """End the process, if it runs."""
        if self._running is not None:
            self._running.end(polite)
            self._running = None
            # not of another process, which may be there
            self._topics.leave()

    def reset(self) -> None:
        """Begin a trial."""
        self.start()
        self._topics.begin(self._reference)

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """What the process answers to a state: voltages [V] or setpoints [rad]."""
        return self._topics.ask(t, setpoint, measurement)


class Servoed:
    """A digital servo whose setpoints come from a process, one each 28 ms."""

    def __init__(self, process: Foreign, servo: Pid) -> None:
        self._process, self._servo, self.period = process, servo, servo.period
        self._sample, self._wanted = 0, (0.0, 0.0, 0.0)

    def reset(self) -> None:
        """Begin a trial."""
        self._process.reset()
        self._servo.reset()
        self._sample = 0

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> Sequence[float]:
        """Voltages of the servo [V]."""
        if self._sample % ROWS == 0:
            wanted = self._process.update(t, setpoint, measurement)
            if len(wanted) != 3:
                raise Ending("refused", f"its command has {len(wanted)} setpoints, not three")
            if not all(map(isfinite, wanted)):
                raise Ending("not_finite", f"setpoints {wanted}")
            self._wanted = wanted
        self._sample += 1
        return self._servo.update(t, self._wanted, measurement)
