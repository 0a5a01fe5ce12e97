# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The page of a motion in a real browser: the arm moves, the plots follow, the buttons work, and nothing leaves the
machine."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from browser_support import needs_chromium
from cli_support import call

pytest.importorskip("viser")
from devtools import Page

from puma_sim_core.recording.recording import Recording, write_csv

pytestmark = needs_chromium
ROOT = Path(__file__).resolve().parent.parent
LOG = ROOT / "examples" / "arm_hidden_effect.csv"
SLIDER = "document.querySelector('[role=slider]')"
NOW = f"Number({SLIDER}.getAttribute('aria-valuenow'))"

#: where the line of the moment stands in a plot: the highest point of its last series
LINE = "((c) => c.data[0][c.data.at(-1).indexOf(Math.max(...c.data.at(-1)))])"
CHARTS = "Object.values(window.__viserTestpoints.uplots).map((each) => each.chart)"


def moved(before: np.ndarray, after: np.ndarray) -> float:
    """How far the middle of the orange pixels went to the side [pixels]."""
    columns = np.arange(len(before))
    return abs(np.average(columns, weights=after) - np.average(columns, weights=before))


def times(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=0)


@pytest.mark.long
def test_a_served_page_plays_pauses_steps_and_seeks(tmp_path):
    write_csv(Recording(np.array([0.0]), setpoint=np.array([[0.3, -1.0, 1.2]])), tmp_path / "setpoints.csv")
    words = ["view", LOG, "--port", "0", "--setpoints", tmp_path / "setpoints.csv"]
    server = subprocess.Popen(
        [sys.executable, "-m", "puma_sim_core", *map(str, words)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    try:
        address = re.match(r"(http://127\.0\.0\.1:\d+) shows", server.stdout.readline())[1]
        with Page(address, tmp_path) as page:
            page.press_until("Play", "Pause")
            page.wait(f"{SLIDER} && {NOW} > 0.2")
            page.press_until("Pause", "Play")
            seek(page, 0.1)
            stood = drawn_at(page, 0.8, 1.2)
            early, pictures = page.wrists(), plots(page)
            assert early.sum() > 30
            # a plot each of position, tracking error and voltage
            assert len(pictures) == 3

            rows = times(LOG)
            page.press("Step")
            stepped = drawn_at(page, stood, stood + 0.1)
            assert abs(stepped - rows[rows > stood + 1e-9][0]) < 2e-3
            page.press("Step back")
            drawn_at(page, stood - 0.1, stepped)

            seek(page, 0.8)
            drawn_at(page, 7.8, 8.2)
            assert moved(early, page.wrists()) > 10.0
            # their pixels, not their data alone
            assert all(now != before for now, before in zip(plots(page), pictures))
            assert all(
                request.startswith((address, address.replace("http", "ws"), "data:", "blob:"))
                for request in page.requests
            )
    finally:
        server.terminate()
        server.wait()


def seek(page: Page, share: float) -> None:
    """Click the slider."""
    page.click("document.querySelector('.mantine-Slider-track')", share)


def drawn_at(page: Page, low: float, high: float) -> float:
    """The slider's time once it stands between two [s], and the line of each plot with it."""
    page.wait(f"{SLIDER} && {NOW} > {low} && {NOW} < {high}")
    page.still()
    page.wait(f"{NOW} > {low} && {NOW} < {high} && {CHARTS}.every((c) => Math.abs({LINE}(c) - {NOW}) < 2e-3)")
    return page.value(NOW)


def plots(page: Page) -> list[str]:
    """The picture of each plot."""
    return page.value(f"{CHARTS}.map((c) => c.ctx.canvas.toDataURL())")


@pytest.mark.long
def test_an_exported_page_plays_from_a_file_with_its_plots(tmp_path):
    path = tmp_path / "page.html"
    assert call("view", LOG, "--export", path) == 0
    line = "parseFloat(document.querySelectorAll('#plots .now')[{}].style.left)"
    with Page(path.as_uri(), tmp_path) as page:
        page.wait(f"{SLIDER} && {NOW} > 0.5")
        first = page.value(line.format(0))
        page.wait(f"{line.format(0)} > {first}")
        # a click on a plot moves the player, which then stands
        moments, wrists = [], []
        for place in (20, 70):
            page.click("document.querySelectorAll('#plots .drawn')[1]", place / 100)
            page.wait(f"Math.abs({line.format(1)} - {place}) < 0.4")  # a pixel is 0.2
            moments.append(page.value(NOW))
            wrists.append(page.wrists())
        assert wrists[0].sum() > 30
        assert moved(*wrists) > 10.0
        left, _, right, _, low, high = map(
            float, page.value("document.querySelectorAll('#plots svg.drawing')[1].dataset.axes").split()
        )
        clicked = low + (np.array([0.2, 0.7]) - left) / (right - left) * (high - low)
        np.testing.assert_allclose(moments, clicked, atol=0.05)
        assert page.value("document.querySelectorAll('#plots svg.drawing').length") == 2
        assert all(request.startswith(("data:", "blob:")) or request == path.as_uri() for request in page.requests)
