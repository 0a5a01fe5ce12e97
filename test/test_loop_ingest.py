# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs are read as they stand, from anyone's CSV and from bags, or refused by line and column."""

from __future__ import annotations

import gzip
import subprocess
import sys
import tracemalloc
import warnings

import cli_support as cli
import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import BagError, PumaSimError, RecordingError
from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.identify.data.log import encoder_step
from puma_sim_core.identify.settings import DATA
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording import csv_rows
from puma_sim_core.simulation.session import Session, SessionConfig

NAMES = "time,voltage1,position1"


def write(path, *lines, end="\n"):
    path.write_text("\n".join(lines) + end)
    return path


@pytest.fixture
def file(tmp_path):
    return tmp_path / "log.csv"


def test_channels_in_any_order_with_comments_and_other_columns(file):
    write(
        file,
        "# a servo",
        "",
        "note,position1,time,voltage1,setpoint1,enable",
        "a,1,0.5,2,3,1",
        "# between",
        "b,4,0.75,5,6,0",
    )
    log = read_log(file, joints=1)
    assert log.time.tolist() == [0.5, 0.75]
    assert log.voltage.tolist() == [[2.0], [5.0]] and log.position.tolist() == [[1.0], [4.0]]
    assert log.setpoint.tolist() == [[3.0], [6.0]] and log.enable.tolist() == [[1.0], [0.0]]
    assert log.velocity is None and log.current is None
    assert log.lines.tolist() == [4, 6] and log.place(1) == "row 2 (line 6)"
    assert log.notes == ("Columns that are not used: note.",)


def test_a_map_reads_anyones_names_and_one_enable_serves_all_joints(file):
    names = ["t_s", "position1", "U1", "U2", "q1", "q2", "on"]
    write(file, ",".join(names), "0,9,1,2,3,4,1", "1,9,5,6,7,8,0")
    columns = {"time": "t_s", "voltage1": "U1", "voltage2": "U2", "position1": "q1", "position2": "q2", "enable": "on"}
    log = read_log(file, columns, 2)
    assert log.voltage.tolist() == [[1.0, 2.0], [5.0, 6.0]]
    assert log.position.tolist() == [[3.0, 4.0], [7.0, 8.0]]
    assert log.enable.tolist() == [[1.0, 1.0], [0.0, 0.0]]
    assert log.notes == ("Columns that are not used: position1.",)


@pytest.mark.parametrize(
    "columns, says",
    [
        ("voltage1=motor_U", ["no column 'motor_U'", "voltage1", "line 1", "motor_V, q_rad"]),
        ("speed1=q_rad", ["unknown channel 'speed1'", "velocity1"]),
        ("voltage1=motor_V", ["channel 'position1' is missing", "motor_V, q_rad"]),
        ("voltage1=q_rad,position1=q_rad", ["'q_rad' is both voltage1 and position1"]),
    ],
)
def test_a_wrong_map_names_the_column_and_those_that_there_are(file, columns, says):
    write(file, "time,motor_V,q_rad", "0,1,2")
    with pytest.raises(RecordingError) as error:
        read_log(file, dict(item.split("=") for item in columns.split(",")), 1)
    assert all(part in str(error.value) for part in says), error.value


@pytest.mark.parametrize(
    "lines, says",
    [
        ((NAMES,), ["has no rows"]),
        ((), ["is empty"]),
        ((NAMES, "0,1,2", "0.1,x,2"), ["line 3, column voltage1: 'x'"]),
        ((NAMES, "0,1,2", "# c", "0.1,1"), ["line 4: 2 fields", "3 numbers"]),
        ((NAMES, "0,1,2,3"), ["line 2: 4 fields"]),
        ((NAMES + ",voltage1", "0,1,2,3"), ["'voltage1' stands twice"]),
        ((NAMES + ",position2,voltage2", "0,1,2,3,4"), ["column 'voltage2'", "1 joint"]),
        (("0,1,2", "1,2,3"), ["channel 'time' is missing"]),
    ],
)
def test_what_cannot_be_read_names_line_and_column(file, lines, says):
    write(file, *lines)
    with pytest.raises(RecordingError) as error:
        read_log(file, joints=1)
    assert all(part in str(error.value) for part in ["log.csv", *says]), error.value


def test_missing_files_directories_and_binary_junk(file, tmp_path):
    for path in (file, tmp_path, tmp_path / "none.mcap"):
        with pytest.raises(PumaSimError, match=path.name):
            read_log(path)
    file.write_bytes(NAMES.encode() + b"\n0,1,2\n\x00\x01\x02\n")
    with pytest.raises(RecordingError, match="not text"):
        read_log(file, joints=1)
    file.write_bytes(bytes(range(128, 256)) * 10)
    with pytest.raises(RecordingError, match="not text"):
        read_log(file, joints=1)


def test_a_file_that_gzip_packed_is_read_as_it_was_and_a_damaged_one_is_refused(file, tmp_path):
    write(file, NAMES, "0,1,2", "1,3,4")
    packed = tmp_path / "log.csv.gz"
    packed.write_bytes(gzip.compress(file.read_bytes()))
    plain, unpacked = (read_log(path, joints=1) for path in (file, packed))
    for name in ("time", "voltage", "position", "lines"):
        assert np.array_equal(getattr(plain, name), getattr(unpacked, name))
    packed.write_bytes(packed.read_bytes()[:-6])
    with pytest.raises(RecordingError, match=r"log\.csv\.gz: is compressed and damaged .*expected a whole gzip file"):
        read_log(packed, joints=1)


def test_a_number_that_is_missing_is_left_to_the_gate(file):
    rows = [f"{0.01 * r},{np.sin(r)},{0.01 * r * r}" for r in range(200)]
    rows[17], rows[30] = "0.17,1,nan", "0.3,,1"
    log = read_log(write(file, NAMES, *rows), joints=1)
    cuts = {fault.channel: fault for fault in check(log, load_mechanism("pendulum")).cuts}
    assert [(cuts[name].row, cuts[name].rows) for name in ("position1", "voltage1")] == [(18, 1), (31, 1)]
    assert "line 19" in cuts["position1"].what


def test_a_row_without_its_end_is_left_out(file):
    log = read_log(write(file, NAMES, "0,1,2", "0.1,1,2", "0.2,1,2.3", end=""), joints=1)
    assert len(log) == 2 and "line 4" in log.notes[0]


def test_blocks_give_what_the_file_holds_and_long_files_are_cut_with_a_note(file, monkeypatch):
    random = np.random.default_rng(5)
    table = np.column_stack([np.arange(5000) * 1e-3, random.normal(size=(5000, 2))])
    lines = [",".join(map(repr, row)) for row in table.tolist()]
    lines[2500] = lines[2500].replace(",", ',"').replace(',"', ",", 1) + '"'  # the slow way
    write(file, NAMES, "# " + 50 * "x", *lines)
    monkeypatch.setattr(csv_rows, "_CHUNK", 7001)
    log = read_log(file, joints=1)
    assert np.array_equal(np.column_stack([log.time, log.voltage, log.position]), table)
    assert np.array_equal(log.lines, np.arange(5000) + 3) and not log.notes
    part = read_log(file, joints=1, greatest_rows=1234)
    assert len(part) == 1234 and np.array_equal(part.time, table[:1234, 0])
    assert "more than 1234 rows" in part.notes[0]


def test_memory_does_not_grow_with_the_file(file):
    with open(file, "w") as out:
        out.write(NAMES + "\n")
        for part in range(20):
            out.write("".join(f"{r * 1e-3:.4f},1.25,0.5\n" for r in range(part * 10000, part * 10000 + 10000)))
    tracemalloc.start()
    log = read_log(file, joints=1, greatest_rows=20000)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(log) == 20000 and most < 60e6


_PEAK = """
import resource, sys
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.plant.mechanism_file import load_mechanism
log = read_log(sys.argv[1])
notes = check(log, load_mechanism()).notes
print(len(log), sum(log.time[1:] <= log.time[:-1]), sum("were read" in note for note in notes),
      resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.long
def test_a_huge_file_takes_no_more_memory_than_the_rows_that_are_read(file):
    """Twice and ten times the rows that are read, of all seven columns of an arm: in a process of
    its own, whose peak is its own. Behind those rows the time would go back."""
    time = 1e-3 * np.arange(DATA.reading_greatest_rows)
    q = np.column_stack([0.5 * np.sin(2.0 * np.pi * f * time) for f in (0.3, 0.4, 0.5)])
    rows = "".join(
        ",".join(f"{value:.4f}" for value in row) + "\n" for row in np.column_stack([time, 10.0 * q, q]).tolist()
    )
    peaks = []
    for times in (2, 10):
        with open(file, "w") as out:
            out.write("time,voltage1,voltage2,voltage3,position1,position2,position3\n")
            for _ in range(times):
                out.write(rows)
        done = subprocess.run([sys.executable, "-c", _PEAK, str(file)], text=True, capture_output=True, check=True)
        read, backwards, told, peak = map(int, done.stdout.split())
        assert (read, backwards, told) == (DATA.reading_greatest_rows, 0, 1)
        peaks.append(peak / 1024.0)  # MB
    assert peaks[1] < peaks[0] + 20.0


def test_a_line_without_end_is_refused(file):
    file.write_text(NAMES + "\n" + "1" * 9_000_000)
    with pytest.raises(RecordingError, match="characters"):
        read_log(file, joints=1)


@pytest.mark.parametrize("step, digits", [(1e-4, 17), (2 * np.pi / 4096, 8), (0.0, 17)])
def test_the_step_of_an_encoder(step, digits):
    q = np.sin(np.arange(3000) * 3e-3) + 1e-7 * np.random.default_rng(2).normal(size=3000)
    q = np.round(q / step) * step if step else q
    q = np.array([float(f"{value:.{digits}g}") for value in q])
    assert encoder_step(q) == pytest.approx(step, rel=1e-4)


def test_changes_of_all_sizes_show_no_encoder_and_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert encoder_step(np.cumsum([1.0, 5.0, *np.arange(10.0, 108.0)])) == 0.0


# -- bags -----------------------------------------------------------------------------------------


def commands(random, steps, silent):
    return {k: [(None, tuple(random.uniform(-50.0, 50.0, 3)))] for k in range(steps) if k % 3 and k not in silent}


def test_a_bag_gives_the_volts_that_were_commanded_and_no_others(tmp_path):
    """Without effects those at the motors are the same: what the session did, limit and watchdog
    included, one row later. With a saturation the log must not show it."""
    steps = 90
    given = commands(np.random.default_rng(3), steps, range(30, 60))
    quiet = SessionConfig(Plant.of("bejczy"), command_timeout=0.3)
    lossy = SessionConfig(
        Plant.of("bejczy", [parse_effect("voltage_saturation:joint=2,voltage=9")]), command_timeout=0.3
    )
    logs = []
    for name, config in (("quiet", quiet), ("lossy", lossy)):
        cli.record_session(tmp_path / name, config, given, steps)
        logs.append(read_log(tmp_path / name))
    session, applied, states = Session(quiet), [], []
    for k in range(steps):
        for _, values in given.get(k, ()):
            session.command(values)
        states.append(session.state)
        applied.append(session.step().voltage)
    for log in logs:
        assert np.array_equal(log.voltage[:-1], applied)
    assert np.array_equal(logs[0].position[:-1], [state.position for state in states])
    assert np.array_equal(logs[0].current[:-1], [state.current for state in states])
    assert np.allclose(logs[0].time, 0.028 * np.arange(steps + 1), rtol=0.0, atol=1e-12)
    assert not np.array_equal(logs[0].position, logs[1].position)


def test_bags_of_positions_need_a_row_for_each_servo_sample(tmp_path):
    given = {k: [(None, (0.001 * k, 0.0, 0.0))] for k in range(20)}
    config = SessionConfig(Plant.of("bejczy"), command_interface="position")
    cli.record_session(tmp_path / "coarse", config, given, 20)
    with pytest.raises(RecordingError, match="30 samples.*substeps 1"):
        read_log(tmp_path / "coarse")
    config = SessionConfig(Plant.of("bejczy"), command_interface="position", period=1e-3, substeps=1)
    cli.record_session(tmp_path / "fine", config, given, 20)
    log = read_log(tmp_path / "fine" / "fine_0.mcap")
    assert len(log) == 21 and np.any(log.voltage != 0.0) and "at the motors" in log.notes[0]
    with pytest.raises(BagError, match="expected 1"):
        read_log(tmp_path / "fine", joints=1)
    with pytest.raises(RecordingError, match="none for a bag"):
        read_log(tmp_path / "fine", {"time": "t"})


def test_what_is_so_of_several_logs_is_noted_once(tmp_path):
    paths = [tmp_path / "one.csv", tmp_path / "two.csv"]
    for path in paths:
        path.write_text("time,voltage1,position1,warmth\n0,1,0,20\n0.01,1,0.1,20\n")
    found = explain([str(path) for path in paths], plant="pendulum")
    assert found.verdict == "DATA_FAULT" and len(found.faults) == 2
    assert found.notes == ("Columns that are not used: warmth.",)
