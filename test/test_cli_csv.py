# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Recordings as files: every bit comes back, and both readers of numbers agree."""

from __future__ import annotations

import csv
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from puma_sim_core.errors import RecordingError
from puma_sim_core.recording import recording as module
from puma_sim_core.recording.recording import GROUPS, Recording, read_csv, write_csv

numbers = st.floats(allow_nan=False, allow_infinity=False)


def bits(array):
    return np.ascontiguousarray(array).view(np.int64).tolist()


def quote_last_time(path):
    """Quote a number: the quick reader then leaves the rows to the other one."""
    *rows, last = path.read_bytes().removesuffix(b"\n").split(b"\n")
    path.write_bytes(b"\n".join([*rows, b'"%s",%s' % tuple(last.split(b",", 1))]) + b"\n")


@settings(max_examples=60)
@given(values=st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=30))
@example(values=[(-0.0, 5e-324, 1.7976931348623157e308), (0.1, 2.2250738585072014e-308, 1e22)])
def test_a_file_reads_back_to_the_same_bits(tmp_path_factory, values):
    path = tmp_path_factory.getbasetemp() / "bits.csv"
    time = np.arange(len(values)) * 0.1 - 0.3
    recording = Recording(time=time, voltage=np.array(values))
    write_csv(recording, path)
    quick = read_csv(path)
    quote_last_time(path)
    careful = read_csv(path)
    for read in (quick, careful):
        assert bits(read.voltage) == bits(recording.voltage) and bits(read.time) == bits(time)


@settings(max_examples=300)
@given(
    field=st.one_of(
        st.text(alphabet="0123456789+-.eE_xXnaif \t'#\"", max_size=8),
        st.text(max_size=4),
        st.floats().map(repr),
        st.decimals(allow_nan=False, allow_infinity=False).map(str),
    )
)
@example(field="1_0")
@example(field="0x10")
@example(field="１")
@example(field=" 1\t")
@example(field="1 ")
@example(field="1e400")
@example(field="1\r2")
def test_both_readers_take_and_refuse_the_same_fields(tmp_path_factory, field):
    """The quick one may leave a field to the other, and must never read another number."""
    path = tmp_path_factory.getbasetemp() / "field.csv"
    text = f"time,voltage1,voltage2,voltage3\n0,1,{field},3\n1,1,2,3\n"
    path.write_bytes(text.encode("utf-8", errors="surrogatepass"))

    def outcome():
        try:
            return bits(read_csv(path).voltage)
        except RecordingError as error:
            return str(error)

    quick = outcome()
    quote_last_time(path)
    assert outcome() == quick
    if isinstance(quick, list):
        assert struct.pack("<q", quick[0][1]) == struct.pack("<d", float(field.strip('" \t')))


def test_the_quick_reader_is_used_for_what_the_simulator_writes(tmp_path, monkeypatch):
    recording = Recording(time=np.arange(50.0), **{g: np.ones((50, 3)) for g in GROUPS})
    write_csv(recording, tmp_path / "run.csv")

    lines, reader = [], csv.reader
    monkeypatch.setattr(csv, "reader", lambda rows, **how: lines.extend(rows) or reader(rows, **how))
    read = read_csv(tmp_path / "run.csv", GROUPS)
    assert len(lines) < 10  # names, and what could be a title or units: no other row is read by itself
    assert list(dict(read.columns())) == list(dict(recording.columns()))


@pytest.mark.parametrize("rows", [1, 4095, 4096, 4097, 10000])
def test_writing_in_parts_loses_no_row(tmp_path, rows):
    random = np.random.default_rng(rows)
    recording = Recording(time=np.arange(float(rows)), voltage=random.normal(size=(rows, 3)))
    seen = []
    with open(tmp_path / "run.csv", "w", encoding="utf-8") as file:
        module.write_rows(recording, file, seen.append)
    assert seen[-1] == rows
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert len(lines) == rows + 1
    assert lines[1:] == [
        ",".join(map(repr, row)) for row in np.column_stack([recording.time, recording.voltage]).tolist()
    ]


def test_a_fault_late_in_a_long_file_is_found(tmp_path):
    rows = [f"{t},1,2,3" for t in range(20000)]
    for r, text, says in (
        (19999, "19999,1,x,3", "line 20001, column voltage2: 'x'"),
        (15000, "15000,1,nan,3", "line 15002, column voltage2: nan"),
        (12345, "12344,1,2,3", "line 12347, column time: time 12344.0"),
        (777, "777,1,2", "line 779: 3 fields"),
    ):
        changed = [*rows[:r], text, *rows[r + 1 :]]
        path = tmp_path / "long.csv"
        path.write_text("\n".join(["time,voltage1,voltage2,voltage3", *changed, ""]))
        with pytest.raises(RecordingError) as error:
            read_csv(path)
        assert says in str(error.value)
