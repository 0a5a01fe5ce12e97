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
import time

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
        assert (f"{kind.name}  (acts on: {kind.acts})" in lines) == (kind.number == 1)


@pytest.mark.parametrize("name", parameter_sets())
def test_a_listed_set_is_a_parameter_file(name, tmp_path, capsys):
    assert call("list", name) == 0
    text = capsys.readouterr().out
    assert from_mapping(yaml.safe_load(text)) == load_parameters(name)
    (tmp_path / "mine.yaml").write_text(text)
    assert call("list", tmp_path / "mine.yaml") == 0
    assert capsys.readouterr().out == text


@pytest.mark.parametrize("name", [kind.name for kind in KINDS.values() if kind.number == 1])
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
    # those that a joint may have beside the first are named with it
    for further in kind.further:
        assert further.name in out and call("list", further.name) == 0
        assert capsys.readouterr().out == out


def test_what_cannot_be_listed_is_refused(tmp_path, capsys):
    assert call("list", "magic") == 2
    assert "'magic' is not known; expected a parameter file, or one of those of" in capsys.readouterr().err
    # the beginning of a name is near, however much is missing
    assert call("list", "coulo") == 2
    assert "or coulomb_friction, which is near, or another of" in capsys.readouterr().err
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
    shown = (re.sub(r"\s", "", each) for each in re.findall(r"simulating: +\d+%", text))
    assert list(dict.fromkeys(shown)) == ["simulating:0%", "simulating:25%", "simulating:100%"]
    # the cursor is shown again, and the line erased
    assert text.rindex("\x1b[?25h") > text.rindex("simulating") and text.endswith("\x1b[2K")


def test_progress_is_a_line_now_and_then_where_there_is_no_terminal():
    file = io.StringIO()
    with output.Progress(file, lines=0.0) as progress:
        progress("fitting", 0.125)
        progress("fitting", 0.5)
    lines = [line.rpartition(",")[0] for line in file.getvalue().splitlines()]
    assert list(dict.fromkeys(lines)) == ["puma-sim: fitting:  12%", "puma-sim: fitting:  50%"]
    with output.Progress(file := io.StringIO(), lines=100.0) as progress:
        progress("fitting", 0.5)
    assert file.getvalue() == ""


def test_a_stage_that_takes_long_is_shown_again():
    file = io.StringIO()
    with output.Progress(file, lines=0.0) as progress:
        progress("fitting", 0.5)
        for _ in range(600):
            if len(file.getvalue().splitlines()) > 2:
                break
            time.sleep(0.1)
    first, *others = (line.rpartition(",")[0] for line in file.getvalue().splitlines())
    assert len(others) > 1 and set(others) == {first}


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
            assert call("simulate", volts, "--force", "--out", tmp_path / "run.csv") == 130
        assert contents(tmp_path) == before
    assert capsys.readouterr().err == ""


# --------------------------------------------------------------------- files that are there, words


@pytest.mark.parametrize(
    "command",
    [
        ("simulate", "volts.csv", "--out", "there.csv"),
        ("model", "--out", "there.csv"),
        ("mechanism", "new", "--kind", "slide", "--drive", "voltage", "there.csv"),
    ],
)
def test_a_file_that_is_there_is_replaced_with_force_alone(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    random_volts(tmp_path / "volts.csv", rows=3)
    there = tmp_path / "there.csv"
    there.write_text("mine")
    assert call(*command) == 2
    assert "there.csv: is there already; expected another name, or --force" in capsys.readouterr().err
    assert there.read_text() == "mine"
    assert call(*command, "--force") == 0
    assert there.read_text() != "mine"


def test_quiet_leaves_warnings_and_verbose_says_the_versions(tmp_path, capsys):
    volts = random_volts(tmp_path / "volts.csv", rows=3)
    words = ("simulate", volts, "--force", "--out", tmp_path / "run.csv", "--limits", "off")
    assert call(*words, "--quiet") == 0
    assert capsys.readouterr().err == ""
    assert call(*words, "--verbose") == 0
    assert capsys.readouterr().err.startswith("puma-sim ")


def test_angles_have_the_unit_that_is_named(tmp_path):
    volts = random_volts(tmp_path / "volts.csv", rows=3)
    for name, start in (("deg", "0,-90deg,0.5"), ("rad", f"0,{-np.pi / 2!r},0.5rad")):
        assert call("simulate", volts, "--out", tmp_path / name, "--initial", start) == 0
    assert (tmp_path / "deg").read_bytes() == (tmp_path / "rad").read_bytes()


def test_columns_of_other_names_and_units_are_read_and_others_left_out(tmp_path, capsys):
    volts = random_volts(tmp_path / "volts.csv", rows=4)
    rows = [line.split(",") for line in volts.read_text().splitlines()[1:]]
    text = "".join(f"{float(t) * 1e3!r},{a},9,{b},{c}\n" for t, a, b, c in rows)
    (tmp_path / "theirs.csv").write_text(f"t_ms,u,heat,voltage2,voltage3\n{text}")
    assert call("simulate", volts, "--out", tmp_path / "a.csv") == 0
    capsys.readouterr()
    names = ("--columns", "time=t_ms,voltage1=u")
    assert call("simulate", tmp_path / "theirs.csv", *names, "--out", tmp_path / "b.csv") == 0
    assert "columns that are not used: heat" in capsys.readouterr().err
    a, b = (np.loadtxt(tmp_path / name, delimiter=",", skiprows=1) for name in ("a.csv", "b.csv"))
    np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind, begin", [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_log_is_drawn_the_same_each_time(kind, begin, tmp_path):
    log = ROOT / "examples" / "pendulum.csv"
    paths = [tmp_path / f"{name}.{kind}" for name in ("a", "b")]
    for path in paths:
        assert call("plot", log, "--plant", "pendulum", "--out", path) == 0
    assert paths[0].read_bytes().startswith(begin)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_a_picture_has_the_name_of_its_log_and_replaces_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    volts = random_volts(tmp_path / "volts.csv", rows=30)
    assert call("simulate", volts, "--out", "run.csv", "--quiet") == 0
    assert call("plot", "run.csv") == 0
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert "run.png" in capsys.readouterr().err
    assert call("plot", "run.csv") == 2
    assert "run.png: is there already" in capsys.readouterr().err


def test_a_shell_completes_the_line(tmp_path):
    pytest.importorskip("argcomplete")
    answer = tmp_path / "answer"
    line = "puma-sim simulate --initial-v"
    environment = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": " "}
    puma_sim(_ARGCOMPLETE_STDOUT_FILENAME=str(answer), **environment)
    assert answer.read_text().strip() == "--initial-velocity"
