# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The process behind `own.PlainPython`: one run of the task for each line of standard input."""

from __future__ import annotations

import gc
import json
import sys
from time import perf_counter

from benchmarks.own import simulation
from benchmarks.task import Task


def serve(seconds: float) -> None:
    """Answer each line with ``[elapsed seconds, [q1, q2, q3]]``."""
    run = simulation(Task.default(seconds))
    gc.disable()
    for _ in sys.stdin:
        start = perf_counter()
        position = run()
        print(json.dumps([perf_counter() - start, position.tolist()]), flush=True)


if __name__ == "__main__":
    serve(float(sys.argv[1]))
