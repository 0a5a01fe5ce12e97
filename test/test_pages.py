# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What all pages share: figures that are the same on every run and small, and text with raised powers."""

from __future__ import annotations

import html
import re
import subprocess
import sys

import numpy as np
import pytest

from puma_sim_core.pages.drawing import svg
from puma_sim_core.pages.figure import COLOURS, Figure, Layer, legend
from puma_sim_core.pages.text import raised, unit_text

X = np.linspace(0.1, 10.0, 50)
KINDS = {
    "line": Layer("line", X, np.sin(X), label="a line"),
    "gap": Layer("line", X, np.where(X > 5.0, np.nan, X), dashes=(4.0, 2.0)),
    "steps": Layer("steps", X, np.cos(X)),
    "dots": Layer("dots", X, np.sin(X), opacity=0.5),
    "marks": Layer("marks", X, np.sin(X), marker="D", hollow=True),
    "band": Layer("band", X, X - 1.0, X + 1.0, opacity=0.2),
    "stems": Layer("stems", X, np.sin(X), colour="blue"),
    "spans": Layer("spans", X[::10], X[::10] + 0.5, colour="span"),
    "map": Layer("map", X, X[:3], np.full((3, 50), np.nan), label="value [1]"),
}


def drawn(*layers, **options) -> Figure:
    return Figure("A title", "time [s]", "angle [rad]", layers, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_layer_is_drawn_the_same_twice_with_labels(kind):
    first = svg(drawn(KINDS[kind]), "one")
    assert svg(drawn(KINDS[kind]), "one") == first
    assert 'aria-label="A title: angle [rad] against time [s]"' in first
    assert ">time [s]</text>" in first and ">angle [rad]</text>" in first


def test_identifiers_of_two_figures_differ():
    found = [set(re.findall(r' id="([^"]*)"', svg(drawn(KINDS["line"]), name))) for name in ("one", "two")]
    assert found[0] and not found[0] & found[1]


def test_all_colours_are_variables_that_differ_on_light_and_dark_pages():
    text = "".join(svg(drawn(layer), "one") for name, layer in KINDS.items() if name != "map")
    assert set(re.findall(r"var\(--(\w+)\)", text)) <= set(COLOURS)
    assert not re.search(r"#[0-9a-f]{6}\b", text)
    for shade in (0, 1):
        assert len({pair[shade] for pair in COLOURS.values()}) == len(COLOURS)


def test_a_long_noisy_line_keeps_its_peaks_and_stays_small():
    y = np.random.default_rng(1).normal(size=60000)
    y[31234] = 40.0
    figure = drawn(Layer("line", np.linspace(0.0, 60.0, y.size), y), y_range=(-50.0, 50.0))
    text = svg(figure, "one")
    assert len(text) < 100_000
    (line,) = re.findall(r'<path d="([^"]*)"[^>]*stroke: var\(--ink\)', text)
    heights = np.array([float(part.split()[1]) for part in re.findall(r"[ML] ([^ML]*)", line)])
    (ends,) = re.findall(r'<clipPath[^>]*><rect x="[^"]*" y="([^"]*)" width="[^"]*" height="([^"]*)"', text)
    top, high = map(float, ends)
    assert heights.min() == pytest.approx(top + 0.1 * high, abs=0.5)


def test_words_of_others_are_escaped_and_no_formula():
    words = "a < b & \"c\" $x$ <script>alert('1')</script>"
    text = svg(Figure(words, words, words, (KINDS["line"],)), "one")
    assert "<script" not in text and words in html.unescape(text).replace("\n", " ")


def test_a_logarithmic_axis_has_plain_numbers_or_powers():
    few, many = (
        svg(drawn(Layer("marks", 10.0 ** np.arange(-n, 1.0), np.arange(n + 1.0), marker="o"), log_x=True), "one")
        for n in (2, 8)
    )
    assert ">0.05</text>" in few and ">10\u207b" in many


def test_figures_share_one_legend():
    figures = [drawn(KINDS["line"], KINDS["steps"]), drawn(KINDS["line"], KINDS["map"])]
    assert legend(figures) == [KINDS["line"]]


@pytest.mark.parametrize(
    "words, shown",
    [
        ("kg.m^2", "kg.m\u00b2"),
        ("3\u00d710^-5 V", "3\u00d710\u207b\u2075 V"),
        ("e^(-12)", "e\u207b\u00b9\u00b2"),
        ("(S23^2)", "(S23\u00b2)"),
        ("D^T", "D^T"),
    ],
)
def test_powers_are_raised(words, shown):
    assert raised(words) == shown


@pytest.mark.parametrize("name, shown", [("1", ""), ("", ""), ("N.m.s2/rad2", "N\u00b7m\u00b7s\u00b2/rad\u00b2")])
def test_units_read_well(name, shown):
    assert unit_text(name) == shown


def test_pages_do_without_pyplot():
    program = "import sys, puma_sim_core.pages.page; print('matplotlib.pyplot' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"
