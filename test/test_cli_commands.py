# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim` as a program: help, version, listings, and what ends it."""

from __future__ import annotations

import io
import os
import pty
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
import yaml
from cli_support import ROOT, call, contents, puma_sim, random_volts, write_volts

from puma_sim_core import __version__
from puma_sim_core.arm.parameters import from_mapping, load_parameters, parameter_sets
from puma_sim_core.cli import COMMANDS, output
from puma_sim_core.effects import KINDS, parse_effect

#: a run that is not over before somebody interrupts it: hours of plain Python
ENDLESS = ("simulate", "volts.csv", "--out", "run.csv", "--limits", "off")


# ----------------------------------------------------------------------------- help and version


def test_version_is_that_of_the_package():
    done = puma_sim("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"puma-sim {__version__}\n", "")


def test_help_names_every_command(capsys):
    with pytest.raises(SystemExit) as end:
        call("--help")
    out = capsys.readouterr().out
    assert end.value.code == 0
    assert {"simulate", "replay", "recover"} <= {command.name for command in COMMANDS}
    for command in COMMANDS:
        assert command.name in out and command.summary in " ".join(out.split())


@pytest.mark.parametrize("name", [c.name for c in COMMANDS])
def test_each_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as end:
        call(name, "--help")
    assert end.value.code == 0 and f"puma-sim {name}" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["simulate", "--help"]])
def test_help_loads_nothing_heavy(arguments):
    code = (
        "import sys\nfrom puma_sim_core.cli import main\n"
        "try:\n    main(sys.argv[1:])\nfinally:\n"
        "    print(sorted({'numba', 'numpy', 'scipy', 'rclpy', 'mcap', 'matplotlib', 'jinja2'} & set(sys.modules)),"
        " file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "[]\n", done.stderr


# ------------------------------------------------------------------------------------- listings


def test_list_holds_the_sets_with_their_sources_and_the_effects(capsys):
    assert call("list") == 0
    lines = capsys.readouterr().out.splitlines()
    for name in parameter_sets():
        place = lines.index(name)
        assert lines[place + 1].strip() == " ".join(load_parameters(name).source.split())
    assert lines.index("bejczy") < min(lines.index(n) for n in parameter_sets() if n != "bejczy")
    for kind in KINDS.values():
        assert f"{kind.name}  (acts on: {kind.acts})" in lines


@pytest.mark.parametrize("name", parameter_sets())
def test_a_listed_set_is_a_parameter_file(name, tmp_path, capsys):
    assert call("list", name) == 0
    text = capsys.readouterr().out
    assert from_mapping(yaml.safe_load(text)) == load_parameters(name)
    (tmp_path / "mine.yaml").write_text(text)
    assert call("list", tmp_path / "mine.yaml") == 0
    assert capsys.readouterr().out == text


@pytest.mark.parametrize("name", KINDS)
def test_a_listed_effect_has_its_equation_units_bounds_and_an_option_that_works(name, capsys):
    kind = KINDS[name]
    assert call("list", name) == 0
    out = capsys.readouterr().out
    for text in (kind.name, kind.sentence, kind.equation, kind.acts):
        assert text in out
    for p in kind.parameters:
        assert f"[{p.unit}]" in out and f"{p.low:g} to {p.high:g}" in out and p.meaning in out
    (line,) = [line for line in out.splitlines() if "--effect" in line]
    option = line.split()[1].replace("1..3", "2")
    for p in kind.parameters:
        # an amplitude that fits every period, else a middling value within the bounds
        value = 0.01 if p.name == "amplitude" else min(max(0.5, p.low), p.high)
        option = option.replace(f"{p.name}=...", f"{p.name}={value}")
    assert parse_effect(option).kind is kind


def test_what_cannot_be_listed_is_refused(tmp_path, capsys):
    assert call("list", "magic") == 2
    assert "'magic' is not known; expected a parameter file, or one of bejczy" in capsys.readouterr().err
    (tmp_path / "bad.yaml").write_text("name: 1\n")
    assert call("list", tmp_path / "bad.yaml") == 2
    assert "bad.yaml" in capsys.readouterr().err


# ------------------------------------------------------------------------------------- its ends


def test_a_reader_that_goes_away_ends_it_quietly(tmp_path):
    volts = random_volts(tmp_path / "volts.csv", rows=5000)
    process = subprocess.Popen(
        [sys.executable, "-m", "puma_sim_core", "simulate", volts, "--out", "-", "--limits", "off"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline().startswith("time,voltage1")
    process.stdout.close()
    assert process.wait(timeout=170) == 141
    # at most how far it was, where that took longer than ten seconds
    assert all(line.startswith("puma-sim: simulating:") for line in process.stderr)
    process.stderr.close()


def test_ctrl_c_ends_it_with_130_and_leaves_nothing(tmp_path):
    """On a terminal, so that the line of progress tells when the run is under way."""
    write_volts(tmp_path / "volts.csv", 5.0 * np.arange(100_000), np.full((100_000, 3), 5.0))
    before = contents(tmp_path)
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "puma_sim_core", *ENDLESS],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=theirs,
        env={**os.environ, "PUMA_SIM_KERNEL": "python", "PYTHONPATH": str(ROOT)},
    )
    os.close(theirs)
    seen = b""
    try:
        while b"%" not in seen:
            seen += os.read(ours, 1000)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=100) == 130
        os.set_blocking(ours, False)
        try:
            seen += os.read(ours, 10000)
        except OSError:  # nothing more, and nobody there
            pass
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        out = process.stdout.read()
        process.stdout.close()
    assert b"simulating: " in seen and b"Traceback" not in seen and out == b""
    assert seen.rstrip().endswith(b"\x1b[2K")
    assert contents(tmp_path) == before


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_is_a_bar_on_a_terminal_that_is_cleared():
    file = Terminal()
    with output.Progress(file, patience=0.0, between=0.0) as progress:
        for share in (0.0, 0.25, 1.0):
            progress("simulating", share)
    text = file.getvalue()
    assert [re.sub(r"\s", "", shown) for shown in re.findall(r"simulating: +\d+%", text)][:3] == [
        "simulating:0%",
        "simulating:25%",
        "simulating:100%",
    ]
    # the cursor is shown again, and the line erased
    assert text.rindex("\x1b[?25h") > text.rindex("simulating") and text.endswith("\x1b[2K")


def test_progress_is_a_line_now_and_then_where_there_is_no_terminal():
    file = io.StringIO()
    with output.Progress(file, lines=0.0) as progress:
        progress("fitting", 0.125)
        progress("fitting", 0.5)
    lines = file.getvalue().splitlines()
    assert [line.rpartition(",")[0] for line in lines] == ["puma-sim: fitting:  12%", "puma-sim: fitting:  50%"]
    with output.Progress(file := io.StringIO(), lines=100.0) as progress:
        progress("fitting", 0.5)
    assert file.getvalue() == ""


def test_a_quick_command_shows_no_progress():
    file = Terminal()
    with output.Progress(file, patience=100.0) as progress:
        progress("simulating", 0.5)
    assert file.getvalue() == ""


def test_an_interrupt_anywhere_in_the_run_is_130(tmp_path, monkeypatch, capsys):
    from puma_sim_core.recording import recording

    volts = random_volts(tmp_path / "volts.csv", rows=10)
    (tmp_path / "run.csv").write_text("mine")
    before = contents(tmp_path)
    for name in ("read_csv", "write_rows"):

        def interrupted(*_, **__):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(recording, name, interrupted)
            assert call("simulate", volts, "--out", tmp_path / "run.csv") == 130
        assert contents(tmp_path) == before
    assert capsys.readouterr().err == ""
