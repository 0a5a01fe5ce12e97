# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The machine while a long run goes on: other work on it, an empty cache, memory of a process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path


class Busy:
    """A number of processes that compute without end."""

    def __init__(self, count: int) -> None:
        self._processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]

    def __enter__(self) -> Busy:
        return self

    def __exit__(self, *_exception) -> None:
        for process in self._processes:
            process.kill()
            process.wait()


def load() -> str:
    """The mean number of processes that wanted to run in the last minute, in words."""
    return f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def memory_kb(process: int) -> int:
    """Resident memory of a process [kB]."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])


class ColdCache:
    """An empty folder for compiled code, and an end for who still compiles into it."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.variables = {"PUMA_SIM_KERNEL": "auto", "NUMBA_CACHE_DIR": str(folder)}
        self._marker = f"NUMBA_CACHE_DIR={folder}".encode()

    def compilers(self) -> list[int]:
        """Process numbers of those that compile into it."""
        found = []
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                ours = self._marker in (entry / "environ").read_bytes().split(b"\0")
                if ours and b"puma_sim_core.identify.compile_ahead" in (entry / "cmdline").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
            except OSError:  # it has ended
                continue
        return found

    def __enter__(self) -> ColdCache:
        return self

    def __exit__(self, *_exception) -> None:
        for number in self.compilers():
            os.kill(number, signal.SIGKILL)
