# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Words of the thesis's experiments: templates, errors, and no entry that nothing uses."""

from __future__ import annotations

import ast
import re

import numpy as np
import pytest

from puma_sim_core.errors import ParameterError
from puma_sim_core.thesis.result import Curve
from puma_sim_core.thesis.wording import FIELDS, FOLDER, Words

TEXT = """
experiments:
  "7.2": {title: Motors, summary: "Of {count}, one."}
rows:
  torque:
    quantity: residual torque, {test.name}
    unit: N.m
    printed: "{volts}"
    note:
      true: agrees within {share:.1f} %
      false: differs
  plain: {quantity: count, printed: 3}
  pair: {quantity: both, ours: "{drop[0]:.2f} and {drop[1]:.2f}; {drop:.1f}"}
  named: {quantity: set, note: {bejczy: this one, else: "not {name}"}}
figures:
  "7.1": {title: "Joint {joint}", x: "time [s]", y: "q{joint} [rad]", curves: {up: "to {joint} V"}, log: y}
  map: {key: "6.3 {name}", title: Map, x: q2, y: q3, value: eigenvalue}
texts:
  stays: {yes: it stays, no: it goes}
tables:
  READINGS: [1, 0.1, 1e-3, word]
"""


class Test:
    __test__ = False
    name = "joint 3"


@pytest.fixture
def words(tmp_path):
    (tmp_path / "chapter_0.yaml").write_text(TEXT)
    return Words("puma_sim_core.thesis.chapter_0", tmp_path)


def test_rows_are_filled(words):
    row = words.row("torque", 2.5, case=np.True_, test=Test, volts=7.5, share=0.25)
    assert (row.quantity, row.unit, row.printed, row.ours) == ("residual torque, joint 3", "N.m", 7.5, 2.5)
    assert row.note == "agrees within 0.2 %"
    row = words.row("plain", 3, agrees=False)
    assert (row.printed, row.unit, row.note, row.agrees) == (3, "", "", False)
    assert words.row("pair", drop=np.array([1.0, 0.125])).ours == "1.00 and 0.12; 1.0, 0.1"
    assert words.row("named", 1, case="bejczy", name="").note == "this one"
    assert words.row("named", 1, case="paul", name="paul").note == "not paul"


def test_figures_results_and_texts_are_filled(words):
    figure = words.figure("7.1", [Curve("up", [0, 1], [2, 3])], joint=2)
    assert (figure.key, figure.title, figure.y_label, figure.curves[0].label) == (
        "7.1",
        "Joint 2",
        "q2 [rad]",
        "to 2 V",
    )
    assert figure.log_y and not figure.log_x
    found = words.heatmap("map", [0, 1], [0, 1], np.eye(2), name="D")
    assert (found.key, found.value_label) == ("6.3 D", "eigenvalue")
    assert words.result("7.2", [words.row("plain", 3)], count=2).summary == "Of 2, one."
    assert words.text("stays", case=True) == "it stays"


def test_numbers_are_read_as_they_stand(words):
    found = words.table("READINGS")
    assert found == [1, 0.1, 0.001, "word"]
    assert [type(each) for each in found] == [int, float, float, str]


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda w: w.row("torqe", 1), "chapter_0.yaml, rows: there is no 'torqe'; expected one of named, pair, plain"),
        (lambda w: w.figure("7.9", []), "figures: there is no '7.9'; expected one of 7.1, map"),
        (lambda w: w.table("X"), "tables: there is no 'X'; expected one of READINGS"),
        (
            lambda w: w.row("torque", 1, case=True, test=Test, share=1),
            "rows, torque: a placeholder .*'volts'.*expected",
        ),
        (lambda w: w.row("plain", 1, share=1), "rows, plain: no text uses share; expected"),
        (lambda w: w.row("plain"), "rows, plain: ours is missing"),
        (lambda w: w.row("pair", 1, drop=(1, 2)), "rows, pair: ours is missing or given twice"),
        (lambda w: w.row("torque", 1, test=Test, volts=1, share=1), "rows, torque: case None; expected one"),
        (lambda w: w.row("plain", 1, case="x"), "rows, plain: case 'x'; expected none"),
        (lambda w: w.text("stays", case=3), "texts, stays, text, case 3: there is no 'else'; expected one of"),
        (
            lambda w: w.figure("7.1", [Curve("down", [0], [0])], joint=2),
            "7.1, curves: there is no 'down'; expected.*up",
        ),
    ],
)
def test_errors_name_file_key_and_what_was_expected(words, call, message):
    with pytest.raises(ParameterError, match=message):
        call(words)


@pytest.mark.parametrize(
    "text, message",
    [
        ("rows: {one: {quantity: x, printd: 3}}", "rows, one: there is no 'printd'; expected one of note, ours"),
        ("rows: {one: {unit: m}}", "rows, one: there is no 'quantity'; expected one of unit"),
        ("rowz: {}", "rowz: there is no 'rowz'; expected one of experiments, figures, rows, tables, texts"),
    ],
)
def test_unknown_and_missing_fields_are_refused(tmp_path, text, message):
    (tmp_path / "chapter_0.yaml").write_text(text)
    with pytest.raises(ParameterError, match=f"chapter_0.yaml, {message}"):
        Words("chapter_0", tmp_path)


def literals(content):
    """All texts of a tree of Python or of data; of an f-string a pattern."""
    if isinstance(content, ast.AST):
        for node in ast.walk(content):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield re.escape(node.value)
            elif isinstance(node, ast.JoinedStr):
                parts = [re.escape(each.value) if isinstance(each, ast.Constant) else ".*" for each in node.values]
                if set(parts) != {".*"}:
                    yield "".join(parts)
    elif isinstance(content, str):
        yield re.escape(content)
    elif isinstance(content, dict):
        for each in (*content, *content.values()):
            yield from literals(each)
    elif isinstance(content, list):
        for each in content:
            yield from literals(each)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_entry_is_used(path):
    content = Words(path.stem).content
    code = ast.parse((FOLDER.parent / f"{path.stem}.py").read_text(encoding="utf-8"))
    used = {*literals(code), *literals(content.get("tables", {}))}
    curves = {name for figure in content.get("figures", {}).values() for name in figure.get("curves", ())}
    keys = {key for section in FIELDS for key in content.get(section, ())} | curves
    assert not [key for key in keys if not any(re.fullmatch(pattern, key) for pattern in used)]
