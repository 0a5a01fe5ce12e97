# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Lines of the core that tests reached, folder by folder: `python test/coverage_table.py` after `make coverage`."""

from __future__ import annotations

import sys
from pathlib import Path

import coverage

ROOT = Path(__file__).resolve().parent.parent
#: least share of the core's lines [%]
LEAST = 95.0


def main() -> int:
    """Print the table; the status is 1 where the core has less than LEAST."""
    data = coverage.Coverage()
    data.load()
    lines: dict[str, list[int]] = {}
    for path in sorted((ROOT / "puma_sim_core").rglob("*.py")):
        _, statements, _, missing, _ = data.analysis2(str(path))
        count = lines.setdefault(path.parent.relative_to(ROOT).as_posix(), [0, 0])
        count[0] += len(statements)
        count[1] += len(statements) - len(missing)
    lines["all"] = [sum(column) for column in zip(*lines.values(), strict=True)]
    for folder, (count, reached) in lines.items():
        print(f"{folder:40} {reached:6} of {count:6} lines, {100.0 * reached / max(count, 1):5.1f} %")
    count, reached = lines["all"]
    return int(100.0 * reached < LEAST * count)


if __name__ == "__main__":
    sys.exit(main())
