# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bags of one run of the node: the first, and one more from each reset on."""

import itertools
from pathlib import Path

from puma_sim_core.errors import BagError
from puma_sim_core.simulation.session import SessionConfig, SessionState


class NodeBag:
    """Writes what the node does to bags, or nothing when there is no path; later bags get _1, _2 and so
    on behind the name of the first."""

    def __init__(self, path: str, namespace: str) -> None:
        self._first = Path(path) if path else None
        self._namespace = namespace
        self._recorder = None

    @property
    def path(self) -> str:
        """Path of the present bag, empty without one."""
        return "" if self._recorder is None else str(self._recorder.path)

    def start(self, config: SessionConfig, model: str, urdf: str, state: SessionState):
        """Begin a bag at a session's first state; returns the former recorder, still open.

        Raises BagError if the bag cannot be made; the former one is still in use then.
        """
        if self._first is None:
            return None
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
        recorder = BagRecorder(path, namespace=self._namespace, config_text=model, urdf=urdf, **same)
        recorder.write_state(state)
        former, self._recorder = self._recorder, recorder
        return former

    def commands(self, time_ns: int, commands) -> None:
        """Record the commands that the step at `time_ns` [ns] consumes."""
        if self._recorder is not None:
            for command in commands:
                self._recorder.write_command(time_ns, command)

    def state(self, state: SessionState) -> None:
        """Record a state."""
        if self._recorder is not None:
            self._recorder.write_state(state)

    def close(self) -> None:
        """Finish the present bag. Raises BagError when that fails."""
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close()
