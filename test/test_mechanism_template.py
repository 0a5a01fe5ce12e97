# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim mechanism` and `puma-sim list`: files to fill in, and how mechanisms are shown."""

from __future__ import annotations

import re

import pytest
from cli_support import call

from puma_sim_core.plant.mechanism_file import load_mechanism, mechanism_names
from puma_sim_core.plant.quantities import AMPLIFIERS
from puma_sim_core.plant.template import template

KINDS = [
    ("pendulum", {"shoulder": "voltage"}),
    ("pendulum", {"shoulder": "torque"}),
    ("slide", {"shoulder": "current"}),
    ("linkage", {"shoulder": "torque", "elbow": "none"}),
    ("linkage", {"base": "voltage", "shoulder": "none"}),
    ("linkage", {"base": "current", "shoulder": "held", "elbow": "voltage"}),
    ("linkage", {"base": "voltage", "shoulder": "voltage", "elbow": "held"}),
    ("linkage", {"base": "held", "shoulder": "voltage", "elbow": "voltage"}),
]


def filled(text: str) -> str:
    """The template with numbers: 1 everywhere, a range, and the optional lines in use."""
    text = re.sub(r"(range: \{value:) ,", r"\1 [-1.0, 2.0],", text)
    # two of the names in comments are prose
    text = re.sub(r"^( *)# (\w+: \{value:)", r"\1\2", text, flags=re.MULTILINE)
    level = text.replace("zero: {value: 0.0", "zero: {value: -1.5707963267948966")
    return re.sub(r"\{value: ,", "{value: 1.0,", level)


@pytest.mark.parametrize("kind, drives", KINDS)
def test_a_filled_file_is_a_mechanism_with_the_joints_asked_for(kind, drives, tmp_path):
    text = template("mine", kind, drives)
    path = tmp_path / "mine.yaml"
    path.write_text(filled(text))
    mechanism = load_mechanism(path)
    moving = [amplifier for amplifier in drives.values() if amplifier != "held"]
    assert mechanism.name == "mine" and mechanism.driven == tuple(amplifier != "none" for amplifier in moving)
    assert mechanism.plant().joints == len(moving)
    # as it is written, the first number that is missing is named
    path.write_text(text)
    with pytest.raises(
        ValueError, match=r"mine.yaml, line \d+, column \d+: \S+value: no value; expected \w+ finite number"
    ):
        load_mechanism(path)


def test_each_drive_has_a_template():
    for amplifier, words in AMPLIFIERS.items():
        assert words in template("mine", "linkage", {"shoulder": amplifier})


def test_new_show_and_list(tmp_path, capsys):
    path = tmp_path / "rotary.yaml"
    new = ("mechanism", "new", path, "--kind", "linkage", "--base", "voltage", "--shoulder", "none")
    assert call(*new) == 0
    assert path.read_text().splitlines()[-1].lstrip().startswith("# viscous_friction")
    assert "name: rotary\n" in path.read_text()
    assert call(*new) == 2
    assert "rotary.yaml: is there already; expected another name" in capsys.readouterr().err
    assert call("mechanism", "show", path) == 2
    assert "base.link.inertia.value: no value; expected a finite number from 0 to 1e+09" in capsys.readouterr().err
    path.write_text(filled(path.read_text()))
    assert call("mechanism", "show", path) == 0
    shown = capsys.readouterr().out
    assert "rotary: 2 joints that move\n" in shown and "joint 2: -1 to 2 rad" in shown and "no drive" in shown
    assert re.search(r"shoulder.mass +1 \+- 0.1 kg", shown)
    assert call("list", "mechanisms") == 0
    listed = capsys.readouterr().out
    assert all(f"{name}  (" in listed for name in mechanism_names()) and "joint 2 passive" in listed
    assert call("list", "qube_pendulum") == 0
    path.write_text(capsys.readouterr().out)
    assert load_mechanism(path).joints == 2


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--kind", "pendulum"), "a mechanism of kind pendulum: no drive; expected one drive, as with --drive voltage"),
        (("--kind", "pendulum", "--shoulder", "none"), "--shoulder of a pendulum; expected --drive"),
        (("--kind", "linkage", "--elbow", "torque"), "elbow torque; expected a shoulder, a base, or both"),
        (("--kind", "linkage", "--drive", "torque"), "--drive of a linkage"),
        (("--kind", "arm", "--base", "voltage"), "expected no drive: an arm has three motors"),
    ],
)
def test_what_no_file_can_be_made_of(arguments, words, tmp_path, capsys):
    assert call("mechanism", "new", tmp_path / "mine.yaml", *arguments) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "mine.yaml").exists()
