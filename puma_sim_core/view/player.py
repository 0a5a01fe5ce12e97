# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A recorded motion in the browser: time slider, play, pause, steps and speed."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from puma_sim_core.view.motion import Motion
from puma_sim_core.view.panel import Panel
from puma_sim_core.view.scene import Scene

#: frames a second of the scene; the plots, which are sent as a whole, follow every third
FRAME_RATE = 24.0
_PLOTS_EVERY = 3
PLAY, PAUSE, BACK, ON = "Play", "Pause", "Step back", "Step"
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5", "10")


class Player:
    """The controls of a motion on a viser server; all browsers see the same moment."""

    def __init__(self, server: Any, motion: Motion) -> None:
        self._server, self._motion, self._figures = server, motion, motion.figures()
        self._first, self._last = float(motion.time[0]), float(motion.time[-1])
        self._moment, self._playing = self._first, True
        self._pressed: deque[str] = deque()
        self._scene = Scene(server, motion.chain, motion.arms)
        self._panel = Panel(server, motion.name, motion.notes)
        step = max(1e-3, 1e-4 * (self._last - self._first))
        self._slider = server.gui.add_slider("time [s]", self._first, self._last, step, self._first)
        self._panel.add_buttons((PLAY, PAUSE, BACK, ON), self._pressed.append)
        self._speed = server.gui.add_dropdown("speed", _SPEEDS, initial_value="1")
        self._panel.draw(self._figures, self._moment)

    def run(self, stopped: Callable[[], bool]) -> None:
        """Play until `stopped()` is true."""
        before, drawn, plotted, frame, sent = time.monotonic(), None, None, 0, self._first
        while not stopped():
            time.sleep(1.0 / FRAME_RATE)
            now = time.monotonic()
            while self._pressed:
                self._press(self._pressed.popleft())
            # a person moved it: asked here and not by a callback, which could overtake that of a button
            if sought := (place := float(self._slider.value)) != sent:
                self._go(place)
            # it does not run away before somebody looks
            looked_at = bool(self._server.get_clients())
            moment = self._advance((now - before) * float(self._speed.value) * looked_at)
            before, frame = now, frame + 1
            if moment != drawn:
                with self._server.atomic():
                    self._scene.show(self._motion.at(moment))
                drawn = moment
            if sought or moment != sent:
                # an equal value would not be sent, and the browser that sought may show one that crossed it on the way
                self._slider.value = sent = float(np.nextafter(moment, np.inf)) if sought else moment
            if moment != plotted and frame % _PLOTS_EVERY == 0:
                self._panel.draw(self._figures, moment)
                plotted = moment

    def _advance(self, seconds: float) -> float:
        if self._playing:
            self._moment = min(self._moment + seconds, self._last)
            self._playing = self._moment < self._last
        return self._moment

    def _go(self, moment: float, playing: bool | None = None) -> None:
        self._moment = min(max(moment, self._first), self._last)
        self._playing = self._playing if playing is None else playing

    def _press(self, button: str) -> None:
        if button == PAUSE:
            self._playing = False
            return
        moment, times = self._moment, self._motion.time
        if button == PLAY:
            self._go(self._first if moment >= self._last else moment, True)
            return
        # a step is a row of the record
        row = np.searchsorted(times, moment, "left") - 1 if button == BACK else np.searchsorted(times, moment, "right")
        self._go(float(times[np.clip(row, 0, len(times) - 1)]), False)
