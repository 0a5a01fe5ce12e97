# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bags of one run of the node: the first, and one more from each reset on."""

import itertools
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import yaml

from puma_sim_core.errors import BagError, PumaSimError
from puma_sim_core.plant.plant import effect_mapping
from puma_sim_core.simulation.session import Command, Effects, Placement, SessionState
from puma_sim_core.simulation.session_config import SessionConfig


class NodeBag:
    """Writes what the node does to bags, or nothing when there is no path; later bags get _1, _2 and so
    on behind the name of the first.

    frames : record the frames of the arm too.
    failed : told of an error of a former bag, which is closed in a thread of its own: its index may be long.
    """

    def __init__(self, path: str, namespace: str, frames: bool, failed: Callable[[str], None]) -> None:
        self._first, self._frames = Path(path) if path else None, frames
        self._namespace, self._failed = namespace, failed
        self._recorder = None
        self._closing: list[threading.Thread] = []
        # what the bag says of the brakes so far, nothing yet, and whether a command for the next step let go of them
        self._braked: bool | None = None
        self._brakes = self._let_go = False

    @property
    def path(self) -> str:
        """Path of the present bag, empty without one."""
        return "" if self._recorder is None else str(self._recorder.path)

    def start(self, config: SessionConfig, model: str, urdf: str, state: SessionState) -> None:
        """Begin a bag at a session's first state, in place of the former one.

        Raises BagError if the bag cannot be made; the former one is still in use then.
        """
        if self._first is None:
            return
        try:
            from puma_sim_core.recording.bag import BagRecorder
        except ImportError as error:
            what, expected = f"{error.name} is not installed", "the Python packages mcap and rosbags"
            raise BagError(what, where="parameter 'bag_path'", expected=expected) from error
        path = self._first
        if self._recorder is not None:
            numbered = (path.with_name(f"{path.name}_{n}") for n in itertools.count(1))
            path = next(candidate for candidate in numbered if not candidate.exists())
        same = {name: getattr(config, name) for name in ("joint_names", "frame_id", "command_interface", "period_ns")}
        texts = {"config_text": model, "urdf": urdf, "frames": self._frames}
        recorder = BagRecorder(path, namespace=self._namespace, **texts, **same)
        recorder.write_state(state)
        former, self._recorder = self._recorder, recorder
        self._braked, self._brakes, self._let_go = None, config.brakes, False
        if former is not None:
            self._closing.append(threading.Thread(target=self._close, args=(former,)))
            self._closing[-1].start()

    def _close(self, recorder) -> None:
        try:
            recorder.close()
        except (PumaSimError, OSError) as error:
            self._failed(str(error))

    def inputs(self, time_ns: int, inputs: Sequence[Command | Placement | Effects]) -> None:
        """Record what the step at `time_ns` [ns] consumes."""
        if self._recorder is None:
            return
        for given in inputs:
            match given:
                case Command():
                    self._let_go = True
                    self._recorder.write_command(time_ns, given)
                case Placement():
                    self._recorder.write_placement(time_ns, given)
                case Effects(effects):
                    text = yaml.safe_dump([effect_mapping(effect) for effect in effects], sort_keys=False)
                    self._recorder.write_effects(time_ns, text)

    def step(self, time_ns: int, braked: bool, state: SessionState) -> None:
        """Record a step from `time_ns` [ns] on: the state, and whether the brakes held, where that changed or where a
        command did not let go of them after all."""
        if self._recorder is not None:
            if self._brakes and (braked != self._braked or (braked and self._let_go)):
                self._recorder.write_brakes(time_ns, braked)
            self._braked, self._let_go = braked, False
            self._recorder.write_state(state)

    def close(self) -> None:
        """Finish all bags. Raises BagError when that fails for the present one."""
        recorder, self._recorder = self._recorder, None
        for thread in self._closing:
            thread.join()
        if recorder is not None:
            recorder.close()
