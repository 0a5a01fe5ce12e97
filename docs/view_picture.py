# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Draw ``docs/view.png``: the demonstration of ``make run`` in the browser, in the middle of its motion.

``python docs/view_picture.py`` needs Chromium, viser and the session in ``build/demo``.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.image

from puma_sim_core.view.page import motion_page
from puma_sim_core.view.sources import session_motion, with_setpoints

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test"))
from devtools import Page  # noqa: E402

#: place of the click in the plots, as a share of their width
SHARE = 0.8

if __name__ == "__main__":
    demo = ROOT / "build" / "demo"
    bag = max(demo.glob("bag*"), key=lambda path: path.stat().st_mtime)
    motion = with_setpoints(session_motion(bag), demo / "controller.csv")
    motion = replace(motion, name="The demonstration of make run")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "page.html"
        path.write_text(motion_page(motion), encoding="utf-8")
        with Page(path.as_uri(), Path(folder), size=(1300, 950)) as page:
            page.wait("!!document.querySelector('[role=slider]')")
            page.click("document.querySelector('#plots .drawn')", SHARE)
            page.value("document.activeElement.blur()")
            picture = page.still()
    matplotlib.image.imsave(ROOT / "docs" / "view.png", picture)
