# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A motion as one HTML file that needs no network: viser's player of recorded scenes, and plots that follow it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from puma_sim_core.pages.page import environment
from puma_sim_core.view.motion import Motion
from puma_sim_core.view.player import FRAME_RATE
from puma_sim_core.view.scene import Scene
from puma_sim_core.view.server import serving

#: frames of a page; a longer motion has fewer a second
_MOST_FRAMES = 5000
_PAGES = environment("puma_sim_core.view")


def motion_page(motion: Motion) -> str:
    """The text of the page.

    Raises PumaSimError: viser is not installed.
    """
    first, last = float(motion.time[0]), float(motion.time[-1])
    frames = min(max(2, int((last - first) * FRAME_RATE) + 1), _MOST_FRAMES)
    moments = np.linspace(first, last, frames)
    with serving(port=0) as server:
        scene = Scene(server, motion.chain, motion.arms)
        recorder = server.get_scene_serializer()
        for moment in moments:
            scene.show(motion.at(float(moment)))
            recorder.insert_sleep((last - first) / frames)
        player = recorder.as_html()
    parts: Any = _PAGES.get_template("motion.html").module
    player = re.sub(r"<title>.*?</title>", lambda _: parts.head(motion), player, count=1)
    page = player.replace("</body>", parts.body(motion, first) + "</body>")
    # what a file name has that is no text becomes a question mark
    return page.encode("utf-8", "replace").decode("utf-8")
