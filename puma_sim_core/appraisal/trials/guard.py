# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A process for a controller of the user's, which may hang, die, or fill memory and screen.

It is forked, sends what it has as it goes on, and is ended where it says nothing for too long.
"""

from __future__ import annotations

import os
import pickle
import resource
import select
import signal
import struct
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from puma_sim_core.appraisal.settings import Patience
from puma_sim_core.appraisal.trials.trial import Ending
from puma_sim_core.simulation.feedback import Controller

_LENGTH = struct.Struct("<Q")
#: what a process sends last that has done its work
_DONE = "done"
#: memory that a controller may take beyond what the process has already [bytes]
_MEMORY = 2 << 30


@dataclass
class Watched:
    """A controller whose every answer is timed: `Ending` is raised in one that takes longer than its patience."""

    controller: Controller
    patience: Patience

    def __post_init__(self) -> None:
        self.period = self.controller.period
        self._asked: float | None = None
        self._since = 0.0
        signal.signal(signal.SIGALRM, self._look)
        signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)

    def _look(self, *_: Any) -> None:
        now, asked = time.monotonic(), self._asked
        if asked is None:
            return
        if now - asked > self.patience.answer:
            self._asked = None
            raise Ending("late", f"no answer within {self.patience.answer:g} s")
        if now - self._since > self.patience.trial:
            self._asked = None
            raise Ending("late", f"all answers of the trial took more than {self.patience.trial:g} s")

    def reset(self) -> None:
        """Forget the past."""
        self._since = self._asked = time.monotonic()
        self.controller.reset()
        self._asked = None

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> Sequence[float]:
        """Voltages of the controller."""
        self._asked = time.monotonic()
        volts = self.controller.update(t, setpoint, measurement)
        self._asked = None
        return volts


class Ended(NamedTuple):
    """How a forked process ended: one of `response.ENDS`, "completed" where it had done its work, and why."""

    end: str
    why: str


def in_child(work: Callable[[Callable[[Any], None]], None], patience: float) -> tuple[list[Any], Ended]:
    """What `work(send)` sends from a forked process, and how that ended.

    patience : greatest time between two things that are sent [s].
    """
    near, far = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(near)
        status = 1
        try:
            _confine()
            with os.fdopen(far, "wb") as pipe:

                def send(value: Any) -> None:
                    content = pickle.dumps(value)
                    pipe.write(_LENGTH.pack(len(content)) + content)
                    pipe.flush()

                work(send)
                send(_DONE)
            status = 0
        finally:
            os._exit(status)
    os.close(far)
    ended = Ended("died", "the caller gave up")
    try:
        sent, in_time = _received(near, patience)
    finally:
        os.close(near)
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
    if not in_time:
        ended = Ended("late", f"its process said nothing for {patience:g} s")
    elif sent and sent[-1] == _DONE:
        return sent[:-1], Ended("completed", "")
    elif os.WIFSIGNALED(status):
        ended = Ended("died", f"its process was ended by signal {signal.Signals(os.WTERMSIG(status)).name}")
    else:
        ended = Ended("died", f"its process ended with status {os.WEXITSTATUS(status)}")
    return sent, ended


def _confine() -> None:
    """Nothing on screen, and an end to memory."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nowhere, number)
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    with open("/proc/self/statm") as file:
        taken = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + _MEMORY, most))


def _received(near: int, patience: float) -> tuple[list[Any], bool]:
    """What was sent, and whether the process went on sending until it ended."""
    sent: list[Any] = []
    buffer = bytearray()
    deadline = time.monotonic() + patience
    while True:
        ready, _, _ = select.select([near], [], [], max(deadline - time.monotonic(), 0.0))
        if not ready:
            return sent, False
        part = os.read(near, 1 << 20)
        if not part:
            return sent, True
        buffer += part
        while len(buffer) >= _LENGTH.size and len(buffer) >= (size := _LENGTH.size + _LENGTH.unpack_from(buffer)[0]):
            sent.append(pickle.loads(buffer[_LENGTH.size : size]))
            del buffer[:size]
            deadline = time.monotonic() + patience
