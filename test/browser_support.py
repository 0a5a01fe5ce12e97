# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Pages of the package in a parser and in a headless browser, for the tests."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
#: no screen, no sandbox (containers run as root), no look-ups of its own
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--enable-logging=stderr",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


class Outline(HTMLParser):
    """Identifiers, links and open elements of a page."""

    VOID = {"meta", "link", "br", "hr", "img", "input"}

    def __init__(self):
        super().__init__()
        self.identifiers, self.references, self.open, self.tags = [], [], [], []

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append(tag)
        if "id" in attrs:
            self.identifiers.append(attrs["id"])
        for name in ("href", "xlink:href", "src"):
            if name in attrs:
                self.references.append(attrs[name])
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def outline_of(text) -> Outline:
    outline = Outline()
    outline.feed(text)
    outline.close()
    assert outline.open == []
    return outline


FRAME = '<iframe style="border:0;width:{width}px;height:900px" srcdoc="{page}"></iframe>'
PROBE = """<!DOCTYPE html><meta charset="utf-8"><body style="margin:0">
{frames}
<pre id="found"></pre>
<script>
function look(inner) {{
  const found = {{}};
  const size = (each) => {{ const r = each.getBoundingClientRect(); return [r.width, r.height]; }};
  found.drawings = [...inner.querySelectorAll("svg.drawing")].map((each) => ({{
    size: size(each), inked: [...each.querySelectorAll("path,use,image,text")].filter((part) => {{
      const box = part.getBBox(); return box.width + box.height > 0; }}).length,
    letters: Math.min(...[...each.querySelectorAll("text")].map((part) =>
      parseFloat(getComputedStyle(part).fontSize) * size(each)[0] / each.viewBox.baseVal.width)),
    outside: [...each.querySelectorAll("text")].filter((part) => {{
      const r = part.getBoundingClientRect(), e = each.getBoundingClientRect();
      return r.left < e.left - 2 || r.right > e.right + 2 || r.top < e.top - 2
        || r.bottom > e.bottom + 2; }}).map((part) => part.textContent) }}));
  found.keys = [...inner.querySelectorAll("svg.key")].map(size);
  found.rows = [...inner.querySelectorAll("tbody tr")].filter(
    (each) => !each.closest("details")).map(size);
  found.width = [inner.documentElement.scrollWidth, inner.documentElement.clientWidth];
  found.wide = [...inner.querySelectorAll("body *")].filter((each) => !each.closest("svg")
    && each.getBoundingClientRect().right > inner.documentElement.clientWidth + 1).map(
    (each) => each.outerHTML.slice(0, 80));
  found.text = inner.body.innerText;
  return found;
}}
addEventListener("load", () => {{
  const found = [...document.querySelectorAll("iframe")].map((each) => look(each.contentDocument));
  document.getElementById("found").textContent = JSON.stringify(found);
}});
</script></body>"""


def browse(path, folder, *flags):
    """Run Chromium on a file; returns its output and what it wrote to the console."""
    done = subprocess.run(
        [CHROMIUM, *FLAGS, f"--user-data-dir={folder / 'profile'}", *flags, path.as_uri()],
        capture_output=True,
        encoding="utf-8",
        timeout=120,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return done.stdout, console


def probe(texts, folder, widths=(1280, 390)) -> list[tuple[str, int, dict]]:
    """What a browser finds in each page at each width [CSS pixels]: (text, width, found)."""
    asked = [(text, width) for text in texts for width in widths]
    path = folder / "probe.html"
    path.write_text(
        PROBE.format(frames="\n".join(FRAME.format(width=width, page=html.escape(text)) for text, width in asked)),
        encoding="utf-8",
    )
    shown, console = browse(path, folder, "--window-size=1300,1000", "--virtual-time-budget=10000", "--dump-dom")
    assert console == []
    found = json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', shown, re.S)[1]))
    return [(*each, what) for each, what in zip(asked, found, strict=True)]


def assert_drawn(texts, folder, least_height=150, least_letters=0.0) -> None:
    """Every figure drawn, nothing wider than the page, no word cut off: on a desk and a phone.

    least_height, least_letters : of a drawing and of the letters in it [CSS pixels].
    """
    for text, width, found in probe(texts, folder):
        assert len(found["drawings"]) == text.count("<figure>")
        for drawing in found["drawings"]:
            across, down = drawing["size"]
            assert 300 <= across <= width and least_height <= down <= 0.9 * across
            assert drawing["inked"] >= 10
            assert drawing["outside"] == [], f"at {width} px outside of a drawing of {drawing['size']}"
            assert drawing["letters"] >= least_letters
        assert all(min(size) > 0 for size in (*found["keys"], *found["rows"]))
        assert found["width"][0] <= found["width"][1] <= width
        assert found["wide"] == []
        assert len(found["text"]) > 500
