# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm of a running simulator in the browser: the last seconds of its motion, and buttons that control it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.view.chain import Chain
from puma_sim_core.view.motion import ARM, SETPOINT, Motion
from puma_sim_core.view.panel import Panel
from puma_sim_core.view.scene import Scene

#: what plots and path show [s]
WINDOW = 20.0
#: seconds between two frames of the scene, and between two states of plots and path
_FRAME, _PLOTS = 1.0 / 24.0, 0.25


class Sample(NamedTuple):
    """A state: time [s]; (J,) each of position [rad], voltage [V], current [A], and setpoint [rad] if there are any."""

    time: float
    position: Sequence[float]
    voltage: Sequence[float]
    current: Sequence[float]
    setpoint: Sequence[float] | None = None


class Live:
    """The page of a running simulator, whose samples all have a setpoint, or none has.

    name : the heading; buttons : their words; `press` gets those of one that was pressed, in the server's event loop.
    """

    def __init__(
        self, server: Any, chain: Chain, name: str, buttons: Sequence[str], press: Callable[[str], None]
    ) -> None:
        self._server, self._chain, self._name = server, chain, name
        self._samples: deque[Sample] = deque()
        self._scene: Scene | None = None
        self._drawn = self._plotted = -inf
        self._panel = Panel(server, name)
        self._panel.add_buttons(buttons, press)
        self._words = server.gui.add_markdown("")

    def say(self, words: str) -> None:
        """Show a sentence below the buttons."""
        self._words.content = words

    def push(self, sample: Sample) -> None:
        """Take a state over; one from before the last begins a new motion."""
        samples = self._samples
        if samples and sample.time < samples[-1].time:
            samples.clear()
        if not samples or sample.time > samples[-1].time:
            samples.append(sample)
        while sample.time - samples[0].time > WINDOW:
            samples.popleft()

    def refresh(self) -> None:
        """Draw the last state, and every quarter of a second plots and path, if it is time to."""
        now = time.monotonic()
        if not self._samples or now - self._drawn < _FRAME:
            return
        self._drawn, last = now, self._samples[-1]
        with self._server.atomic():
            if self._scene is None or now - self._plotted >= _PLOTS:
                self._plotted = now
                self._scene = self._plot()
            arms = {ARM: last.position} if last.setpoint is None else {ARM: last.position, SETPOINT: last.setpoint}
            self._scene.show({name: np.array(position) for name, position in arms.items()})

    def _plot(self) -> Scene:
        columns = list(zip(*self._samples))
        times, position, voltage, current = map(np.array, columns[:4])
        setpoint = None if columns[4][0] is None else np.array(columns[4])
        # a voltage is published with the state that it led to
        volts = np.concatenate([voltage[1:], voltage[-1:]])
        motion = Motion(self._name, self._chain, times, position, voltage=volts, current=current, setpoint=setpoint)
        scene = self._scene or Scene(self._server, self._chain, motion.arms)
        for name, positions in motion.arms.items():
            scene.draw_path(name, positions)
        self._panel.draw(motion.figures())
        return scene
