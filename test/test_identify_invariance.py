# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The answer must not depend on what changes no physics: the changes of `make rigs`, on a synthetic log."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from loop_logs import record
from rigs.jobs import mechanism_path
from rigs.judging import flipped
from rigs.logs import Table, write_table
from rigs.variants import VARIANTS, Given, command_in_thousandths, position_in_millimetres, unit_power

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.effects.base import Role
from puma_sim_core.files import read_yaml, yaml_text
from puma_sim_core.identify import explain
from puma_sim_core.identify.report.json import report_mapping
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.resources import config_path

#: of one log; those of several logs, and of processes, are in `make rigs`
CHANGES = (
    *("held_out_added", "time_shifted", "mirrored", "command_in_thousandths", "column_added", "every_second_row"),
    "noise_added",
)
NAMES = ("time", "voltage1", "position1")


@cache
def synthetic() -> tuple[Table, Table]:
    """Two logs of a pendulum with Coulomb friction, 500 rows a second."""
    mechanism = load_mechanism("pendulum")
    plant = mechanism.plant(mechanism.start * 1.02, (parse_effect("coulomb_friction:joint=1,torque=0.05"),))
    log = record(mechanism, plant, volts=0.05, noise=2e-4)
    values = np.column_stack([log.time, log.voltage, log.position])
    return Table("first", NAMES, values[:3000]), Table("second", NAMES, values[3000:])


def outcome(given: Given, folder: Path) -> dict:
    """What `make rigs` keeps of an answer."""
    path = folder / "mechanism.yaml"
    path.write_text(yaml_text(given.mechanism), encoding="utf-8")
    logs, held_out = ([str(write_table(table, folder)) for table in group] for group in (given.logs, given.held_out))
    return {"report": report_mapping(explain(logs, held_out=held_out, plant=str(path), columns=given.columns))}


def with_floor(given: Given, found: dict) -> Given:
    """With the floor of an answer, which noise is added in proportion to."""
    return replace(given, floor=tuple(found["report"]["errors"]["held_out"]["voltage_rms"]["floor"]))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """(what is given, the answer) of a synthetic log as it is."""
    first, second = synthetic()
    given = Given((first,), spare=(second,), mechanism=read_yaml(mechanism_path("pendulum")))
    found = outcome(given, tmp_path_factory.mktemp("plain"))
    assert [(effect["name"], effect["joint"]) for effect in found["report"]["effects"]] == [("coulomb_friction", 1)]
    return with_floor(given, found), found


@pytest.mark.long
@pytest.mark.parametrize("name", CHANGES)
def test_a_change_without_physics_changes_no_answer(name, plain, tmp_path):
    given, before = plain
    assert flipped(before, outcome(VARIANTS[name].change(given), tmp_path), name) == []


@pytest.mark.parametrize(
    "name, change, powers",
    [
        ("pendulum", command_in_thousandths, {"V": 1, "A": -1}),
        # of a drive on current the command is the current
        ("slide", command_in_thousandths, {"V": 1, "A": 1}),
        ("slide", position_in_millimetres, {"m": 1, "kg": -1}),
    ],
)
def test_what_a_machine_may_have_is_the_same_in_any_unit(name, change, powers, tmp_path):
    mapping = read_yaml(mechanism_path(name))
    log = Table("log", NAMES, np.zeros((2, len(NAMES))))
    changed = change(Given((log,), columns=dict(zip(NAMES, NAMES)), mechanism=mapping))
    (tmp_path / "changed.yaml").write_text(yaml_text(changed.mechanism), encoding="utf-8")
    before, after = load_mechanism(name), load_mechanism(str(tmp_path / "changed.yaml"))
    for kind in KINDS.values():
        for parameter in (p for p in kind.parameters if p.plausible is not None):
            factor = 1000.0 ** unit_power(before.unit(parameter.unit), powers)
            joint = 0 if kind.per_joint else None
            own, other = (np.array(machine.plausible(parameter, joint)) for machine in (before, after))
            np.testing.assert_allclose(other, factor * own, rtol=1e-9)


MACHINES = [load_mechanism(path.stem) for path in sorted(config_path("mechanisms").glob("*.yaml"))]


@pytest.mark.parametrize("machine", [m for m in MACHINES if m.links_known], ids=lambda machine: machine.name)
def test_a_law_allows_whatever_a_machine_may_have(machine):
    for kind in KINDS.values():
        # a stiffness of which more is less of an effect begins at an absolute value yet (docs/rigs.md)
        for parameter in (p for p in kind.parameters if p.plausible is not None and not p.inverse):
            for joint in range(machine.joints) if kind.per_joint else (None,):
                least, most = machine.plausible(parameter, joint)
                if parameter.role is Role.RATE:
                    least /= FITTING.below_plausible
                assert parameter.low <= least and most <= parameter.high, (kind.name, parameter.name)
