# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Draw ``docs/report.png``: explain the sample log with a hidden effect, photograph the report.

``python docs/report_picture.py`` needs Chromium.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import puma_sim_core as ps

DOCS = Path(__file__).resolve().parent


def photograph(page: Path, picture: Path, width: int = 1100, height: int = 820) -> None:
    """Write the top of an HTML page as PNG."""
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--window-size={width},{height}")
    subprocess.run(["chromium", *flags, f"--screenshot={picture}", page.resolve().as_uri()], check=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        found = ps.explain(str(DOCS.parent / "examples" / "arm_hidden_effect.csv"))
        ps.write_explanation(found, folder)
        photograph(Path(folder) / "report.html", DOCS / "report.png")
