# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The commands and programs of README and docs/ run, in order, with what examples/ ships.

Before each block of bash or Python stands a comment: `run`, `run long`, or `not run: REASON`.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
DERIVED = {"effects.md", "equations.md", "api.md", "measures_table.md", "mechanism_numbers.md"}
PAGES = [ROOT / "README.md", *(p for p in sorted((ROOT / "docs").glob("*.md")) if p.name not in DERIVED)]
_BLOCK = re.compile(
    r"(?:^<!-- (?P<mark>[^\n]*) -->\n)?^```(?P<kind>bash|console|python)\n(?P<text>.*?)^```$", re.M | re.S
)
_FENCED = re.compile(r"^```(?:bash|console|python|sh)\b", re.M)


class Block(NamedTuple):
    """A block of a page: its mark ("run", "run long" or "not run: ..."), kind and text."""

    mark: str
    kind: str
    text: str


def blocks_of(page: Path) -> list[Block]:
    """The blocks of bash and Python of a page, in order."""
    found = _BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [Block(match["mark"] or "", match["kind"], match["text"]) for match in found]


def pages_with(*marks: str) -> list[Path]:
    return [page for page in PAGES if any(block.mark in marks for block in blocks_of(page))]


def with_command(programs: Path) -> dict[str, str]:
    """An environment in which `puma-sim` is that of this checkout."""
    programs.mkdir()
    command = programs / "puma-sim"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m puma_sim_core "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    return {
        **os.environ,
        "PATH": os.pathsep.join((str(programs), os.environ["PATH"])),
        "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
    }


def run_blocks(page: Path, folder: Path, marks: tuple[str, ...]) -> None:
    """Run the blocks of a page that have one of the marks, in a folder with the examples."""
    for path in EXAMPLES.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    shutil.copytree(EXAMPLES / "effects", folder / "effects")
    environment = with_command(folder / ".programs")
    if any("--effects" in block.text for block in blocks_of(page) if block.mark in marks):
        # a kernel with an effect of one's own would be compiled, for longer than all of these commands take
        environment["PUMA_SIM_KERNEL"] = "python"
    for block in blocks_of(page):
        if block.mark in marks:
            program = ["bash", "-euc"] if block.kind == "bash" else [sys.executable, "-c"]
            ran = subprocess.run([*program, block.text], cwd=folder, env=environment, capture_output=True, text=True)
            assert ran.returncode == 0, f"{page.name}:\n{block.text}\n{ran.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_each_block_says_whether_it_runs(page):
    blocks = blocks_of(page)
    assert len(blocks) == len(_FENCED.findall(page.read_text(encoding="utf-8")))
    for block in blocks:
        assert re.fullmatch(r"run|run long|not run: \S.*", block.mark), block.text


def test_no_example_writes_what_another_wrote():
    """All pages can be followed one after the other in one folder."""
    written = [
        name
        for page in PAGES
        for block in blocks_of(page)
        if block.kind == "bash" and block.mark in ("run", "run long")
        for line in block.text.replace("\\\n", " ").splitlines()
        if "--force" not in line
        for name in re.findall(r"(?:--out|--export|mechanism new) (\S+)", line)
    ]
    assert sorted(written) == sorted(set(written))


@pytest.mark.parametrize("page", pages_with("run"), ids=lambda page: page.name)
def test_quick_blocks_run(page, tmp_path):
    run_blocks(page, tmp_path, ("run",))


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("page", pages_with("run long"), ids=lambda page: page.name)
def test_all_blocks_run_in_order(page, tmp_path):
    run_blocks(page, tmp_path, ("run", "run long"))


def test_the_examples_are_what_their_script_makes(tmp_path):
    subprocess.run(
        [sys.executable, str(EXAMPLES / "make_logs.py"), str(tmp_path)],
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    shipped = sorted(EXAMPLES.glob("*.csv"))
    assert [path.name for path in sorted(tmp_path.iterdir())] == [path.name for path in shipped]
    for path in shipped:
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def test_the_examples_are_small():
    assert sum(path.stat().st_size for path in EXAMPLES.iterdir() if path.is_file()) < 1_000_000


def test_pictures_are_small():
    assert all(path.stat().st_size < 300_000 for path in (ROOT / "docs").glob("*.png"))


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", text):
        assert target in DERIVED or (page.parent / target).exists(), target


def test_the_site_builds_without_warnings(tmp_path):
    pytest.importorskip("sphinx")
    pytest.importorskip("myst_parser")
    docs = tmp_path / "site" / "docs"
    shutil.copytree(ROOT / "docs", docs, ignore=shutil.ignore_patterns("_build", "*.pyc"))
    for name in ("puma_sim_core", "examples"):
        (tmp_path / "site" / name).symlink_to(ROOT / name)
    ran = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(docs), str(tmp_path / "html")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_example_of_the_command_line_runs(tmp_path):
    out = tmp_path / "report"
    ran = subprocess.run(
        ["bash", str(EXAMPLES / "explain.sh"), str(out)],
        env=with_command(tmp_path / "programs"),
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    assert "Coulomb friction" in ran.stdout
    assert (out / "run.csv").exists()


def test_the_example_in_python_runs():
    ran = subprocess.run(
        [sys.executable, str(EXAMPLES / "simulate.py")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    assert "coulomb_friction" in ran.stdout


def test_the_example_over_topics_runs():
    pytest.importorskip("rclpy")
    from ros_support import Node, environment

    with Node() as node:
        ran = subprocess.run(
            [sys.executable, str(EXAMPLES / "topics.py"), "--ros-args", "-r", f"__ns:={node.namespace}"],
            env=environment(),
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert ran.returncode == 0, ran.stderr
    assert "position after 50 states" in ran.stdout
