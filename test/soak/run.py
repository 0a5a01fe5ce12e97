# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Long runs of `sim_node`; each prints a line for each part of it, and ends with status 1 where something did not hold.

  python test/soak/run.py fuzz --count 1000000       messages, parameters and service calls, bad and good
  python test/soak/run.py kill --count 100           SIGKILL at random moments; what the bag keeps
  python test/soak/run.py memory --count 1000000     steps with a bag; memory over them
  python test/soak/run.py start --count 20 --busy 4  first state and Ctrl-C from a cold cache
  python test/soak/run.py pace --busy 2 --cold       a minute in real time: lateness
  python test/soak/run.py demo --count 10 --busy 4   the demonstration, from a cold cache with --cold

Each takes --seed, and --busy: processes that compute beside it.
"""

from __future__ import annotations

import os

os.environ["PUMA_SIM_KERNEL"] = "python"  # replays begin at once; the nodes choose for themselves

import argparse
import sys
import tempfile
from pathlib import Path

if __name__ == "__main__" and not __package__:
    # run as a script: the package is this folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    __package__ = "soak"

import ros_support

from soak import demonstrations, fuzz, kills, memory, pace, starts
from soak.machine import Busy, load

#: longest wait for an answer [s]: the machine may do other work
_PATIENCE = 300.0
#: name -> the run, and how often where nothing else is asked for
RUNS = {
    "fuzz": (fuzz.run, 20_000),
    "kill": (kills.run, 10),
    "memory": (memory.run, 100_000),
    "start": (starts.run, 10),
    "pace": (pace.run, 60),
    "demo": (demonstrations.run, 10),
}


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=RUNS)
    parser.add_argument("--count", type=int, help="of messages, kills, steps, starts, seconds or demonstrations")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--busy", type=int, default=0, metavar="N", help="processes that compute beside it")
    parser.add_argument("--cold", action="store_true", help="with nothing compiled before (pace, demo)")
    options = parser.parse_args(arguments)
    run, count = RUNS[options.what]
    ros_support.PATIENCE = _PATIENCE
    with Busy(options.busy), tempfile.TemporaryDirectory(prefix="soak-") as folder:
        print(f"{options.what}: seed {options.seed}, {load()}", flush=True)
        failures = 0
        for line, held in run(Path(folder), options.count or count, options.seed, options.cold):
            failures += not held
            print(f"{'' if held else 'FAILED '}{line}", flush=True)
        print(f"{failures} failed; {load()}", flush=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
