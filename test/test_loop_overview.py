# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs as people have them: other delimiters, units in names, other names; and what a log holds before any fit."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from cli_support import ROOT, call, puma_sim
from loop_logs import record

from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.overview import overview
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.recording.column_names import suggested, unit_of
from puma_sim_core.recording.csv_rows import CsvRows

PENDULUM = load_mechanism("pendulum")
ROWS = ((0.0, 1.5, -0.25), (0.01, 2.0, 1e-3), (0.02, -3.25, 4.0))


@pytest.fixture
def file(tmp_path):
    return tmp_path / "log.csv"


@pytest.mark.parametrize(
    "text",
    [
        "time,voltage1,position1\n{0},{1},{2}\n{3},{4},{5}\n{6},{7},{8}\n",
        "time;voltage1;position1\n{0};{1};{2}\n{3};{4};{5}\n{6};{7};{8}\n",
        "time\tvoltage1\tposition1\n{0}\t{1}\t{2}\n{3}\t{4}\t{5}\n{6}\t{7}\t{8}\n",
        '\ufeff# a remark, with commas\r\n"time";"voltage1";"position1"\r\n'
        '"{0}";{1};{2}\r\n{3};{4};{5}\r\n{6};{7};{8}\r\n',
    ],
    ids=["comma", "semicolon", "tab", "quoted"],
)
def test_the_numbers_are_the_same_behind_any_delimiter(file, text):
    for decimal in "." if text.startswith("time,") else ".,":
        assert_numbers(file, text, decimal)


def assert_numbers(file, text, decimal):
    numbers = [repr(value).replace(".", decimal) for row in ROWS for value in row]
    file.write_text(text.format(*numbers), encoding="utf-8", newline="")
    rows = CsvRows(file)
    assert rows.names == ["time", "voltage1", "position1"]
    (block,) = rows.blocks(range(3))
    assert np.array_equal(block.values, ROWS)


@pytest.mark.parametrize(
    "row, words",
    [
        ("0,0,1", "line 2: 3 fields; expected 2 numbers"),
        ('0,"0,1"', "line 2, column voltage1: '0,1'; expected a number"),
    ],
)
def test_a_decimal_comma_between_commas_is_refused_by_its_line(file, row, words):
    file.write_text(f"time,voltage1\n{row}\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=f"{words}.*decimal commas, a semicolon or a tab"):
        list(CsvRows(file).blocks(range(2)))


def test_a_log_of_one_row_is_refused_with_what_is_enough(file):
    file.write_text("time,voltage1,position1\n0,1.5,-0.25\n")
    said = "\n".join(overview(read_log(file, joints=1), PENDULUM).lines("rad"))
    assert "the log is too short: 1 row over 0 s from row 1 (line 2) on; expected 100 rows and 1 s at least" in said
    assert "nothing of it can be used" in said


TITLES = "Rig 4,run of May,\n2nd axis held\n"


@pytest.mark.parametrize(
    "title, units, scales",
    [
        ("", "s,V,rad", (1.0, 1.0, 1.0)),
        (TITLES, "", (1.0, 1.0, 1.0)),
        ("Rig 4,2026\n2026-11-28T09:00:00,second run\n", "", (1.0, 1.0, 1.0)),
        (TITLES, "[ms],(mV),deg", (1e-3, 1e-3, np.pi / 180.0)),
        ("", ",mV,", (1.0, 1e-3, 1.0)),
    ],
)
def test_titles_are_skipped_and_a_line_of_units_is_obeyed(file, title, units, scales):
    rows = ["0,1.5,-0.25", "10,2,0.001", "20,-3.25,4"]
    file.write_text("\n".join([title + "time,voltage1,position1", *filter(None, [units]), *rows, ""]))
    log = read_log(file, joints=1)
    table = np.column_stack([log.time, log.voltage, log.position])
    assert np.allclose(table, np.array([row.split(",") for row in rows], float) * scales, rtol=1e-15)
    before = title.count("\n") + 1 + bool(units)
    assert log.lines.tolist() == [before + 1, before + 2, before + 3]
    assert any("Lines before the names" in note for note in log.notes) == bool(title)
    if units and not title:  # not so in files of commands, where a text is a mistake
        with pytest.raises(RecordingError, match="line 2, column .* expected a number"):
            list(CsvRows(file).blocks(range(3), finite=True))


@pytest.mark.parametrize(
    "line, words",
    [
        ("time,voltage1,position1", "'time'"),
        ("s,V,inch", "column position1: 'inch'; expected a number, or a unit among rad, deg"),
    ],
)
def test_a_second_header_that_is_no_line_of_units_is_refused_by_its_line(file, line, words):
    file.write_text(f"time,voltage1,position1\n{line}\n0,1,2\n")
    with pytest.raises(RecordingError, match=f"line 2, .*{words}") as error:
        read_log(file, joints=1)
    assert "begins with #" in str(error.value)


def test_of_two_lines_of_names_the_one_with_the_channels_is_told(file):
    file.write_text("t_ms,motor,encoder\ntime,voltage1,position1\n0,1,2\n")
    with pytest.raises(RecordingError, match="line 1: channel 'time' is missing.*Line 2 has it: leave one") as error:
        read_log(file, joints=1)
    assert "By their names" not in str(error.value)


@pytest.mark.parametrize(
    "form, zone",
    [("{:%Y-%m-%dT%H:%M:%S.%f}", ""), ("{:%Y-%m-%d %H:%M:%S.%f}", "Z"), ("{:%Y-%m-%dT%H:%M:%S.%f}", "000+05:30")],
)
def test_dates_are_times_since_the_first_one(file, form, zone):
    begin, steps = datetime(2026, 12, 31, 23, 59, 59, 990000), 1e-3 * np.arange(2000)
    dates = [form.format(begin + timedelta(seconds=float(step))) + zone for step in steps]
    file.write_text("\n".join(["time,voltage1,position1", *(f"{date},1,2" for date in dates), ""]))
    assert np.allclose(read_log(file, joints=1).time, steps, rtol=0.0, atol=1e-9)
    # a change of the zone is none of the time, and a date is no voltage
    file.write_text("time,voltage1,position1\n2026-03-29T01:59:59.5+01:00,1,2\n2026-03-29T03:00:00+02:00,1,2\n")
    assert read_log(file, joints=1).time.tolist() == [0.0, 0.5]
    for bad in ("2026-03-29T01:00:00,2026-03-29,2", "2026-13-29T01:00:00,1,2"):
        file.write_text(f"time,voltage1,position1\n0,1,2\n{bad}\n")
        with pytest.raises(RecordingError, match="line 3, column (time|voltage1): '2026.* or a date such as"):
            read_log(file, joints=1)


@pytest.mark.parametrize("factor, unit", [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_times_in_another_unit_are_refused_with_the_name_that_helps(file, factor, unit):
    log = record(PENDULUM, PENDULUM.plant(), seconds=3.0)
    table = np.column_stack([factor * log.time, log.voltage, log.position]).tolist()
    rows = [",".join(map(repr, row)) for row in table]
    file.write_text("\n".join(["time,voltage1,position1", *rows, ""]))
    (fault,) = overview(read_log(file, joints=1), PENDULUM).checked.faults
    assert fault.channel == "time" and f"if these are {unit}, a column named time_{unit}" in fault.what
    file.write_text("\n".join([f"time_{unit},voltage1,position1", *rows, ""]))
    columns = suggested([f"time_{unit}", "voltage1", "position1"], ("voltage",))
    assert np.allclose(read_log(file, columns, 1).time, log.time, rtol=0.0, atol=1e-9)


def test_columns_in_each_others_place_are_suspected():
    log = read_log(ROOT / "examples" / "pendulum.csv", joints=1)
    found = overview(Log("exchanged", log.time, log.position, log.voltage), PENDULUM)
    assert found.exchanged and "voltages and positions exchanged?" in "\n".join(found.lines("rad"))
    assert not overview(Log("great", log.time, 1e3 * log.voltage, log.position), PENDULUM).exchanged


@pytest.mark.parametrize(
    "name, group, factor",
    [
        ("t_ms", "time", 1e-3),
        ("t [ns]", "time", 1e-9),
        ("q1_deg", "position", np.pi / 180.0),
        ("position1 (mm)", "position", 1e-3),
        ("motor_V", "voltage", 1.0),
        ("u1_mV", "voltage", 1e-3),
        ("q_meas", "position", 1.0),
        ("q_V", "position", 1.0),
        ("deg", "position", 1.0),
    ],
)
def test_a_unit_stands_behind_a_name(name, group, factor):
    assert unit_of(name, group)[1] == factor


def test_units_in_the_names_are_converted_with_a_note(file):
    rows = [f"{10.0 * k!r},{float(1e3 * np.sin(k))!r},{float(np.degrees(np.cos(k)))!r}" for k in range(50)]
    file.write_text("\n".join(["t_ms,u_mV,q_deg", *rows, ""]))
    log = read_log(file, {"time": "t_ms", "voltage1": "u_mV", "position1": "q_deg"}, 1)
    k = np.arange(50)
    assert np.allclose(log.time, 0.01 * k, rtol=1e-15) and np.allclose(log.voltage[:, 0], np.sin(k), rtol=1e-14)
    assert np.allclose(log.position[:, 0], np.cos(k), rtol=1e-14)
    assert [note.split()[6] for note in log.notes] == ["time", "voltage", "position"]


def test_the_name_of_a_channel_may_have_its_unit_behind_it(file):
    rows = [f"{10.0 * k!r},{float(np.sin(k))!r},{float(np.degrees(np.cos(k)))!r}" for k in range(50)]
    file.write_text("\n".join(["time_ms,voltage1,position1_deg", *rows, ""]))
    log = read_log(file, None, 1)
    assert np.allclose(log.time, 0.01 * np.arange(50), rtol=1e-15)
    assert np.allclose(log.position[:, 0], np.cos(np.arange(50)), rtol=1e-14)
    # which of two is meant is not guessed
    file.write_text("\n".join(["time_ms,voltage1,position1_deg,position1_rad", *(f"{row},0" for row in rows), ""]))
    with pytest.raises(RecordingError, match="channel 'position1' is missing"):
        read_log(file, None, 1)


@pytest.mark.parametrize(
    "names, joints, expected",
    [
        (
            ["t_s", "goal_rad", "q_rad", "qd_rad_s", "motor_V"],
            1,
            {"time": "t_s", "voltage1": "motor_V", "position1": "q_rad"},
        ),
        (
            ["Time [s]", "q2_deg", "q1_deg", "u1_V", "u2_V"],
            2,
            {"voltage1": "u1_V", "position1": "q1_deg", "position2": "q2_deg"},
        ),
        (["t", "theta", "volts", "torque"], 1, {"voltage1": "volts", "position1": "theta"}),
        (["t", "speed", "volts"], 1, {}),
        (["t", "q", "u"], 3, {}),
    ],
)
def test_columns_are_suggested_by_their_names_or_not_at_all(names, joints, expected):
    found = suggested(names, ("voltage",) * joints)
    assert expected.items() <= found.items() and bool(found) == bool(expected)


def test_the_suggestion_is_a_command_that_works(file, tmp_path):
    log = record(PENDULUM, PENDULUM.plant(), seconds=3.0)
    table = np.column_stack([1e3 * log.time, log.voltage, np.degrees(log.position)]).tolist()
    rows = [";".join(map(repr, row)) for row in table]
    file.write_text("\n".join(["t_ms;motor_V;q_deg", *rows, ""]).replace(".", ","))
    refused = puma_sim("explain", file, "--plant", "pendulum", "--dry-run")
    assert refused.returncode == 2
    option, columns = refused.stderr.split("By their names: ")[1].split()
    shown = puma_sim("explain", file, "--plant", "pendulum", option, columns, "--dry-run")
    assert shown.returncode == 0 and "1500 rows over 2.998 s, a row every 2 ms" in shown.stdout
    assert "converted" in shown.stdout and list(tmp_path.iterdir()) == [file]


def test_an_overview_tells_the_motion_and_what_it_can_show():
    log = record(PENDULUM, PENDULUM.plant(), seconds=6.0)
    found = overview(log, PENDULUM)
    (motion,) = found.motion
    assert np.allclose(motion.position, (log.position.min(), log.position.max()), atol=2e-3)
    assert motion.speed == pytest.approx(np.abs(np.gradient(log.position[:, 0], log.time)).max(), rel=0.02)
    shown, hidden = ({each.name for each in own} for own in (found.shown, found.hidden))
    assert {"coulomb_friction", "joint_spring", "input_delay"} <= shown and not shown & hidden
    # one that rests shows nothing
    still = Log("still", log.time, 0.0 * log.voltage, 0.0 * log.position + 0.5)
    refused = overview(still, PENDULUM)
    assert refused.motion == () and "nothing of it can be used" in refused.lines("rad")[-1]


def test_a_dry_run_says_what_is_left_out_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = (ROOT / "examples" / "pendulum.csv").read_text().splitlines()
    del lines[900:906]
    (tmp_path / "gap.csv").write_text("\n".join([*lines, ""]))
    assert call("explain", "gap.csv", "--plant", "pendulum", "--dry-run") == 0
    said = capsys.readouterr().out
    assert "a gap of 0.035 s" in said and "1994 rows in 2 parts" in said and "can show: coulomb_friction" in said
    assert [path.name for path in tmp_path.iterdir()] == ["gap.csv"]


def test_explain_without_a_folder_says_how_to_look_first(capsys):
    assert call("explain", ROOT / "examples" / "pendulum.csv", "--plant", "pendulum") == 2
    assert "expected --out DIR for a report, or" in capsys.readouterr().err
