# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The whole in one go: `python examples/sessions/line.py --out DIR`.

Starts `sim_node` and the example controller as two processes over DDS, lets the controller lead
the arm down its vertical line, ends the node, replays the bag through the core, draws the motion
and says how it went.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from picture import draw_motion
from two_programs import PATIENCE, as_program, run_session

from puma_sim_core.compiling import Compilation
from puma_sim_core.errors import PumaSimError
from puma_sim_core.recording.bag import BagContents, read_bag
from puma_sim_core.recording.recording import Recording, read_csv
from puma_sim_core.simulation.replay import replay, session_of


class DemoError(PumaSimError):
    """The demonstration did not come out as it must."""


def move(out: Path, mode: str) -> tuple[Path, Recording, str]:
    """Run both programs. Returns the bag, what the controller noted, and the node's last line.

    Raises
    ------
    ProgramError : one of them failed, or did not end in time.
    """
    table = out / "controller.csv"
    table.unlink(missing_ok=True)
    bag, summary = run_session(
        out,
        {"mode": mode, "paused": mode == "realtime"},
        "external_controller",
        {"log_path": table, "timeout": PATIENCE},
    )
    return bag, read_csv(table, required=("voltage", "setpoint", "position")), summary


def _lines(bag: BagContents, table: Recording, summary: str) -> list[str]:
    """What a person wants to know."""
    error = np.degrees(table.setpoint - table.position)
    rms, worst = np.sqrt((error**2).mean(axis=0)), np.abs(error).max(axis=0)
    period = bag.period_ns * 1e-9
    lost = round((table.time[-1] - table.time[0]) / period) + 1 - len(table)
    lines = [
        f"tracking error: rms {rms[0]:.3f}, {rms[1]:.3f}, {rms[2]:.3f} deg; "
        f"worst {worst[0]:.3f}, {worst[1]:.3f}, {worst[2]:.3f} deg (joints 1, 2, 3)",
        f"steps: {bag.steps[-1]} of {1e3 * period:g} ms, {lost} lost on the way to the controller",
    ]
    found = re.search(
        r"overruns (\d+)(?:, stalls \d+ \((\S+) s given up\))?, lateness median ([\d.]+) ms, p99 ([\d.]+) ms", summary
    )
    if found:
        overruns, given_up, median, p99 = found.groups("0")
        held_up = "" if given_up == "0" else f"; the machine stood still for {given_up} s, which were left out"
        lines.append(f"lateness: median {median} ms, 99 % below {p99} ms; {overruns} overruns{held_up}")
    return lines


def run(out: Path, mode: str) -> None:
    """The demonstration; raises PumaSimError when something of it fails."""
    out.mkdir(parents=True, exist_ok=True)
    print(
        "sim_node and external_controller, two processes over DDS: the arm moves down a vertical "
        f"line ({mode}). This takes about 15 s, longer on a busy machine.",
        flush=True,
    )
    Compilation(lambda text: print(text, flush=True))
    bag_path, table, summary = move(out, mode)
    result = replay(bag_path)
    bag = read_bag(bag_path)
    for line in _lines(bag, table, summary):
        print(line)
    print(
        f"replay identical: {result.steps} steps, to the last bit"
        if result.identical
        else f"replay differs: {result.first_difference}"
    )
    print(f"bag: {bag_path}")
    arm = session_of(bag_path, bag.config_text)[0].plant.arm
    picture = out / "motion.png"
    draw_motion(bag, table, arm, picture)
    print(f"picture: {picture}")
    if not result.identical:
        raise DemoError("the replay differs from the recording", where=bag_path)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python examples/sessions/line.py", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the bag and the rest")
    parser.add_argument("--mode", choices=("realtime", "lockstep"), default="realtime")
    options = parser.parse_args(args)
    return as_program("demo", lambda: run(options.out, options.mode))


if __name__ == "__main__":
    sys.exit(main())
