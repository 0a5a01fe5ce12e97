# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What ``/diagnostics`` says of the simulation."""

from collections.abc import Mapping
from dataclasses import asdict

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from puma_sim_core.jit import kernel_in_use
from puma_sim_core.simulation.session import Counters, Session
from puma_sim_ros.messages import diagnostics
from puma_sim_ros.node.pacing import Pacer

#: field of `Counters` -> what it counts
_COUNTED = {
    "rejected": "commands rejected",
    "saturated": "commands saturated",
    "limited": "steps at a joint limit",
    "braked": "brakes engaged",
}


class Health:
    """Makes the messages; counts over resets what a session counts since the last one."""

    def __init__(self, name: str) -> None:
        self._name, self._before = name, Counters()

    def add(self, counters: Counters) -> None:
        """Take over the counts of a session that is over."""
        for field, count in asdict(counters).items():
            setattr(self._before, field, getattr(self._before, field) + count)

    def message(
        self, now, session: Session, pacer: Pacer, publishers: int, standing: str, values: Mapping[str, object]
    ) -> DiagnosticArray:
        """The message at a stamp.

        publishers : the greatest number on one topic of commands; standing : running, paused, or what failed; values :
        further ones.
        """
        state, config = session.state, session.config
        age, timeout = session.command_age_steps, config.timeout_steps
        limited = [name for name, at_limit in zip(config.joint_names, session.at_limit) if at_limit]
        level, text = DiagnosticStatus.OK, standing
        if standing not in ("running", "paused"):
            level = DiagnosticStatus.ERROR
        elif publishers > 1:
            level, text = DiagnosticStatus.WARN, f"{publishers} publishers on one topic of commands"
        elif limited:
            level, text = DiagnosticStatus.WARN, f"at a limit: {', '.join(limited)}"
        elif standing == "running" and timeout and age >= timeout:
            level, text = DiagnosticStatus.WARN, "no command within command_timeout"
        counts = {f"{what}": getattr(session.counters, field) for field, what in _COUNTED.items()}
        totals = {f"{what}, in all": getattr(self._before, field) + counts[what] for field, what in _COUNTED.items()}
        found = {
            "step": state.step,
            "simulated time [s]": f"{state.time_ns / 1e9:.9g}",
            **values,
            "kernel": kernel_in_use(),
            "brakes": "engaged" if session.braking else "released" if config.brakes else "none",
            "joints at a limit": ", ".join(limited) or "none",
            "real time factor": pacer.real_time_factor,
            "overruns": pacer.overruns,
            "stalls": pacer.stalls,
            "time given up [s]": f"{pacer.given_up:.3f}",
            **{f"lateness {name} [ms]": value for name, value in pacer.lateness.in_ms().items()},
            **counts,
            **totals,
            "command age [s]": f"{age * config.period:.9g}",
            "publishers of commands": publishers,
        }
        return diagnostics(now, self._name, level, text, found)
