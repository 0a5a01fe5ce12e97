# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bench of real machines: its variants of logs, whose answers must be the same, and its tables."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigs.catalogue import Log
from rigs.judging import flipped
from rigs.logs import Table, as_file, read_table, table_of, write_table
from rigs.variants import (
    FAST,
    NOISE,
    PAUSE,
    SHIFT,
    VARIANTS,
    Given,
    command_in_thousandths,
    every_second_row,
    held_out_added,
    held_out_removed,
    logs_concatenated,
    logs_reversed,
    mirrored,
    noise_added,
    position_in_millimetres,
    time_shifted,
    unit_power,
)
from rigs_support import effect, outcome, report

from puma_sim_core.effects import KINDS
from puma_sim_core.files import read_yaml
from puma_sim_core.plant.linkage.linkage_file import read_linkage
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant
from puma_sim_core.resources import config_path
from puma_sim_core.simulation.simulator import Simulator

MECHANISMS = {name: read_yaml(config_path("mechanisms", f"{name}.yaml")) for name in ("pendulum", "slide")}


def made(rows=40, rate=500.0, name="a", seed=0):
    random = np.random.default_rng(seed)
    time = np.arange(rows) / rate
    return Table(name, ("t", "u", "q", "on"), np.column_stack([time, random.normal(size=(rows, 2)), np.ones(rows)]))


COLUMNS = {"time": "t", "voltage1": "u", "position1": "q", "enable": "on"}
PLAIN = Given(
    (made(), made(30, name="b", seed=1)),
    (made(20, name="c", seed=2),),
    (made(20, name="d", seed=3),),
    COLUMNS,
    MECHANISMS["pendulum"],
    (0.4,),
)


def same(one, two):
    return one.names == two.names and np.array_equal(one.values, two.values)


def test_held_out_logs_come_and_go_and_nothing_else():
    more = held_out_added(PLAIN)
    assert [t.name for t in more.held_out] == ["c", "d"] and more.logs == PLAIN.logs
    assert held_out_added(replace(PLAIN, spare=())) is None
    less = held_out_removed(PLAIN)
    assert less.held_out == () and less.logs == PLAIN.logs
    assert held_out_removed(replace(PLAIN, held_out=())) is None


def test_the_order_of_logs_is_reversed():
    assert [t.name for t in logs_reversed(PLAIN).logs] == ["b", "a"]
    assert logs_reversed(replace(PLAIN, logs=PLAIN.logs[:1])) is None


def test_concatenated_logs_keep_their_rows_and_steps():
    (whole,) = logs_concatenated(PLAIN).logs
    first, second = PLAIN.logs
    assert len(whole) == len(first) + len(second)
    assert np.array_equal(whole.values[: len(first)], first.values)
    assert np.array_equal(whole.values[len(first) :, 1:], second.values[:, 1:])
    steps = np.diff(whole.column("t"))
    assert steps[len(first) - 1] == pytest.approx(PAUSE)
    assert np.delete(steps, len(first) - 1) == pytest.approx(1.0 / 500.0)
    assert logs_concatenated(replace(PLAIN, logs=PLAIN.logs[:1])) is None


def test_the_time_origin_moves_and_the_steps_stay():
    moved = time_shifted(PLAIN)
    for one, two in zip((*PLAIN.logs, *PLAIN.held_out), (*moved.logs, *moved.held_out)):
        assert np.array_equal(two.column("t"), one.column("t") + SHIFT)
        assert np.array_equal(two.values[:, 1:], one.values[:, 1:])


def test_mirroring_turns_positions_voltages_and_the_range():
    turned = mirrored(replace(PLAIN, mechanism=MECHANISMS["slide"]))
    for one, two in zip(PLAIN.logs, turned.logs):
        assert np.array_equal(two.values, one.values * [1.0, -1.0, -1.0, 1.0])
    assert turned.mechanism["range"]["value"] == [-0.30, 0.05]
    assert MECHANISMS["slide"]["range"]["value"] == [-0.05, 0.30]  # as it was
    assert mirrored(replace(PLAIN, mechanism=None)) is None
    again = mirrored(turned)
    assert all(map(same, again.logs, PLAIN.logs)) and again.mechanism == MECHANISMS["slide"]


def test_a_column_is_added_and_no_other_changes():
    changed = VARIANTS["column_added"].change(PLAIN)
    for one, two in zip(PLAIN.logs, changed.logs):
        assert two.names[:-1] == one.names and np.array_equal(two.values[:, :-1], one.values)


@given(st.integers(2, 60), st.sampled_from([100.0, 399.0, FAST + 1.0, 1000.0]))
def test_every_second_row_is_dropped_of_fast_logs_alone(rows, rate):
    table = made(rows, rate)
    changed = every_second_row(Given((table,), columns=COLUMNS))
    if rate < FAST:
        assert changed is None
    else:
        assert np.array_equal(changed.logs[0].values, table.values[::2])


def test_noise_is_a_tenth_of_the_floor_on_the_fitted_voltages_and_seeded():
    table = made(20000)
    one = noise_added(Given((table,), (table,), columns=COLUMNS, floor=(0.4,), seed=3))
    added = one.logs[0].values - table.values
    assert added[:, 1].std() == pytest.approx(NOISE * 0.4, rel=0.03)
    assert not added[:, [0, 2, 3]].any() and same(one.held_out[0], table)
    again, other = (noise_added(Given((table,), columns=COLUMNS, floor=(0.4,), seed=seed)) for seed in (3, 4))
    assert same(again.logs[0], one.logs[0]) and not same(other.logs[0], one.logs[0])
    assert noise_added(Given((table,), columns=COLUMNS)) is None


def simulated(mapping, volts, position):
    """(n,) positions of a machine, of which all numbers are as its file says."""
    time = 0.002 * np.arange(len(volts))
    simulator = Simulator(LinkagePlant.of(read_linkage(mapping)))
    simulator.reset([position])
    return simulator.run(time, volts[:, None]).position[:, 0]


@pytest.mark.parametrize("name", MECHANISMS)
@pytest.mark.parametrize(
    "change, scale", [(mirrored, -1.0), (command_in_thousandths, 1.0), (position_in_millimetres, 1e3)]
)
def test_a_machine_in_other_units_moves_as_before(name, change, scale):
    volts = 1.5 * np.sin(0.05 * np.arange(200))
    table = Table("a", ("t", "u", "q", "on"), np.column_stack([0.002 * np.arange(200), volts, volts, volts]))
    changed = change(Given((table,), columns=COLUMNS, mechanism=MECHANISMS[name]))
    if change is position_in_millimetres and name == "pendulum":
        assert changed is None
        return
    new = changed.logs[0]
    assert np.array_equal(new.column("q"), scale * table.column("q"))
    before = simulated(MECHANISMS[name], volts, 0.1)
    after = simulated(changed.mechanism, new.column("u"), 0.1 * scale)
    assert after == pytest.approx(scale * before, rel=1e-6, abs=1e-9 * abs(scale))
    # the priors are as wide in proportion as they were
    old, other = (read_linkage(m) for m in (MECHANISMS[name], changed.mechanism))
    for one, two in zip(old.parameters, other.parameters):
        assert two.known == one.known
        if one.value:
            assert two.deviation / two.value == pytest.approx(one.deviation / one.value)


def test_units_in_thousandths():
    powers = {"V": 1, "A": -1, "ohm": 2}
    for unit, power in (("V", 1), ("V.s/rad", 1), ("1/A", 1), ("N.m/A", 1), ("N.m", 0), ("1", 0), ("ohm", 2)):
        assert unit_power(unit, powers) == power
    assert unit_power("N.s2/m2", {"m": 1}) == -2
    for kind in KINDS.values():
        for parameter in kind.parameters:
            unit_power(parameter.unit, powers)
    one = effect("voltage_offset", 1, voltage=(0.5, 0.4, 0.6))
    one["parameters"]["voltage"]["unit"] = "V"
    two = effect("voltage_offset", 1, voltage=(510.0, 400.0, 600.0))
    two["parameters"]["voltage"]["unit"] = "V"
    base, changed = outcome(report("NAMED", one)), outcome(report("NAMED", two))
    assert flipped(base, changed, "command_in_thousandths") == []
    assert flipped(base, changed, "column_added") != []


@settings(max_examples=25)
@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 2), min_size=1, max_size=20))
def test_tables_are_read_as_they_were_written(tmp_path_factory, rows):
    folder = tmp_path_factory.mktemp("tables")
    table = Table("some log", ("t", "q"), np.array(rows))
    path = write_table(table, folder)
    packed = folder / "packed.csv.gz"
    packed.write_bytes(gzip.compress(b"# a comment\n" + path.read_bytes()))
    assert same(read_table(path), table) and same(read_table(packed), table)


def test_a_stretch_of_a_log_keeps_its_times(tmp_path):
    write_table(made(100), tmp_path)
    part = table_of(Log("a.csv", 0.05, 0.1), tmp_path, "t")
    assert part.column("t")[0] == 0.05 and len(part) == 25 and part.name == "a 0.05-0.1 s"
    assert as_file(Log("a.csv"), tmp_path, "t", tmp_path) == tmp_path / "a.csv"
    assert len(read_table(as_file(Log("a.csv", end=0.1), tmp_path, "t", tmp_path))) == 50
