# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What is written from an explanation: JSON that keeps its schema, a page that stands alone."""

from __future__ import annotations

import errno
import html
import json
import re
from contextlib import contextmanager
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from browser_support import CHROMIUM, assert_drawn, browse, needs_chromium, outline_of
from cli_support import contents
from loop_support import EXPLANATIONS, HARD, drawn, faulty, named, nothing, one_joint, tied, unnamed

from puma_sim_core import files
from puma_sim_core.effects import KINDS
from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.report import output
from puma_sim_core.identify.report.figures import residual_against, residual_in_time, whiteness
from puma_sim_core.identify.report.html import page
from puma_sim_core.identify.report.json import report_text
from puma_sim_core.identify.report.output import check_folder, write_explanation
from puma_sim_core.identify.report.text import estimate
from puma_sim_core.identify.result import VERDICTS, Interval, NamedEffect
from puma_sim_core.pages.drawing import svg
from puma_sim_core.pages.text import number, quantity
from puma_sim_core.plant.model_file import load_model
from puma_sim_core.resources import config_path

COMMON = ("found", "errors", "residual", "ranking", "whiteness", "unseen", "logs")
SECTIONS = {
    "named": (*COMMON, "feedback", "next", "parameters"),
    "tied": (*COMMON, "feedback", "next", "parameters"),
    "nothing": (*COMMON, "feedback", "next", "parameters"),
    "remainder": (*COMMON, "shape", "feedback", "next", "parameters"),
    "unnamed": (*COMMON, "shape", "feedback", "next", "parameters"),
    "faulty": ("faults", "found", "logs"),
    "one_joint": COMMON,
}
each_explanation = pytest.mark.parametrize("made", EXPLANATIONS.values(), ids=EXPLANATIONS)


@pytest.fixture(scope="module")
def schema():
    path = config_path("explain_report.schema.json")
    found = json.loads(path.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(found)
    return jsonschema.Draft202012Validator(found)


@pytest.fixture(scope="module")
def pages():
    """The pages of the examples by their names."""
    return {name: page(made()) for name, made in EXPLANATIONS.items()}


def parsed(explanation) -> dict:
    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(report_text(explanation), parse_constant=refuse)


# -------------------------------------------------------------------------------------------- JSON


def test_the_examples_have_every_verdict():
    assert {made().verdict for made in EXPLANATIONS.values()} == set(VERDICTS)


@each_explanation
def test_json_keeps_its_schema(schema, made):
    schema.validate(parsed(made()))


@pytest.mark.parametrize(
    "change",
    [
        lambda found: found.update(verdict="MAYBE"),
        lambda found: found.update(verdict="NOTHING_MISSING"),
        lambda found: found.update(shape=parsed(unnamed())["shape"]),
        lambda found: found.update(verdict="DATA_FAULT", effects=[]),
        lambda found: found.pop("seed"),
        lambda found: found.update(surprise=1),
        lambda found: found["effects"][0].update(joint=0),
        lambda found: found["effects"][0]["parameters"]["torque"].update(ci95=[1.0]),
        lambda found: found["errors"].update(held_out=None),
        lambda found: found["errors"]["fit"]["position_rms"].pop("floor"),
        lambda found: found["detectability"][0].update(size="SMALL"),
    ],
)
def test_the_schema_refuses_what_the_report_does_not_promise(schema, change):
    found = parsed(named())
    change(found)
    assert not schema.is_valid(found)


def test_every_number_of_the_schema_says_what_it_is(schema):
    def assert_described(node, path):
        if isinstance(node, dict):
            types = node.get("type", ())
            if {"number", "integer"} & set([types] if isinstance(types, str) else types) and (
                path[-1] not in ("items", "anyOf")
            ):
                assert "description" in node, path
            for key, value in node.items():
                assert_described(value, (*path, key))

    for section in ("properties", "$defs"):
        assert_described(schema.schema[section], (section,))


def test_json_holds_what_was_found_with_every_digit():
    e = named()
    found = parsed(e)
    (effect,) = found["effects"]
    assert (effect["name"], effect["joint"]) == ("coulomb_friction", 2)
    assert effect["parameters"] == {"torque": {"value": 9.973, "ci95": [9.81, 10.14], "unit": "N.m"}}
    assert [each["name"] for each in effect["ruled_out"]][:1] == ["asymmetric_coulomb_friction"]
    position = found["errors"]["held_out"]["position_rms"]
    assert position["augmented"] == e.errors["held_out"].position_rms.augmented.tolist()
    sizes = {(each["name"], each["joint"]): each for each in found["detectability"]}
    assert sizes["coulomb_friction", 2]["size"] == 0.8
    assert sizes["stribeck_friction", 1]["size"] == "NOT_EXCITED"
    assert sizes["soft_stop", 1]["needed"] is None
    assert sizes["payload", None]["unit"] == "kg"
    assert found["parameters"]["motor.resistance2"]["prior_width"] == pytest.approx(0.096)


def test_what_is_not_finite_is_null():
    found = parsed(tied())
    assert found["effects"][1]["parameters"]["z"]["ci95"] == [-1e-3, None]
    assert found["feedback_bias"]["p_value"] == [1e-9, 0.2, None]
    assert found["logs"][1] == "bad?.csv"


@pytest.mark.parametrize("name", EXPLANATIONS)
def test_the_same_bytes_but_for_the_seconds(name, pages):
    made = EXPLANATIONS[name]
    first, second = report_text(made()), report_text(replace(made(), seconds=123.456))
    assert report_text(made()) == first
    differing = [pair for pair in zip(first.splitlines(), second.splitlines(), strict=True) if pair[0] != pair[1]]
    assert [pair[1] for pair in differing] == [' "seconds": 123.456,']
    assert page(made()) == pages[name]


# -------------------------------------------------------------------------------------------- page


@pytest.mark.parametrize("name", EXPLANATIONS)
def test_page_stands_alone_and_has_its_sections(name, pages):
    text = pages[name]
    outline = outline_of(text)
    assert len(outline.identifiers) == len(set(outline.identifiers))
    assert set(SECTIONS[name]) == set(re.findall(r'<section id="(\w+)"', text))
    for reference in outline.references:
        assert reference.startswith(("#", "data:")), reference
        if reference.startswith("#"):
            assert reference[1:] in outline.identifiers
    for reference in re.findall(r"url\(([^)]*)\)", text):
        assert reference.strip("'\"").startswith("#"), reference
    assert "script" not in outline.tags and "@import" not in text
    assert not re.search(r"https?://(?!www\.w3\.org/(2000/svg|1999/xlink))", text)
    assert "nan" not in re.findall(r"[a-z]+", text.lower())


@pytest.mark.parametrize("name", EXPLANATIONS)
def test_every_figure_has_a_title_a_label_on_each_axis_and_a_legend(name, pages):
    for figure in re.findall(r"<figure>.*?</figure>", pages[name], re.DOTALL):
        title, label = re.search(r"<figcaption>(.+)</figcaption>.*aria-label=\"(.+?)\"", figure, re.DOTALL).groups()
        up, across = label.removeprefix(f"{title}: ").split(" against ")
        assert f">{up}</text>" in figure and f">{across}</text>" in figure
    assert len(re.findall(r'<div class="figures">.*?</div>\s*<ul class="legend">', pages[name], re.DOTALL)) == pages[
        name
    ].count('<div class="figures">')


def test_words_of_others_are_escaped(pages):
    text = pages["tied"] + pages["faulty"]
    assert "<script" not in text and "alert(1)" in text
    # headline, note, feedback, file name, fault
    assert html.unescape(text).count(HARD) >= 6
    text.encode("utf-8")


def test_the_top_says_what_how_sure_and_how_much(pages):
    top = pages["named"].split("<nav")[0]
    for words in (
        "Coulomb friction on joint",
        "9.97",
        "9.81 to 10.14",
        "+1834 nat",
        "Error 21 times smaller",
        "14.7",
        "0.470",
        "[mrad]",
    ):
        assert words in top
    assert "Tied with voltage dead-band" in pages["tied"].split("<nav")[0]
    assert "position2, row 412" in pages["faulty"].split("<nav")[0]
    assert "[mm]" in pages["one_joint"]


def test_what_the_record_could_not_show_stands_high_where_nothing_is_missing(pages):
    text = pages["nothing"]
    assert re.findall(r'<section id="(\w+)"', text)[:2] == ["found", "unseen"]
    assert "Stribeck friction (joint\N{NO-BREAK SPACE}1)" in text
    assert "soft stop (all joints)" in text


def test_every_look_alike_has_its_reason(pages):
    text = html.unescape(pages["named"])
    for each in named().effects[0].ruled_out:
        assert each.because[1:] in text


# ----------------------------------------------------------------------------------------- figures


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_each_kind_is_drawn_against_a_variable_that_matters(kind):
    assert kind.drawn_against
    e = named()
    joint = 2 if kind.per_joint else None
    parameters = {p.name: Interval(5.0, 4.0, 6.0, p.unit) for p in kind.parameters}
    e = replace(e, effects=(NamedEffect(kind.name, joint, parameters, 50.0),))
    charts = residual_against(e)
    assert len(charts) == (1 if kind.per_joint else 3)
    for chart in charts:
        axis, unit = re.fullmatch(r"(.*) \[(.+)\]", chart.x_label).groups()
        assert axis == "time" or axis.replace(" ", "_") in e.drawn.signals
        assert unit and re.search(r"\[m?V\]", chart.y_label)
        outline_of(svg(chart, "one"))


def test_an_impulse_is_drawn_near_its_time():
    e = named()
    effect = NamedEffect(
        "impulse",
        2,
        {
            "time": Interval(7.0, 6.9, 7.1, "s"),
            "width": Interval(0.1, 0.08, 0.12, "s"),
            "torque": Interval(80.0, 70.0, 90.0, "N.m"),
        },
        50.0,
    )
    (chart,) = residual_against(replace(e, effects=(effect,)))
    assert chart.x_range == pytest.approx((6.4, 7.6))


def test_friction_is_drawn_as_the_step_that_it_is():
    (chart,) = residual_against(named())
    before, after = (layer for layer in chart.layers if layer.width == 2.6)
    gap = int(np.flatnonzero(np.isnan(before.x))[0])
    assert before.x[gap - 1] < 0.0 < before.x[gap + 1]
    assert before.y[gap + 1] - before.y[gap - 1] > 0.9
    assert np.nanmax(np.abs(after.y)) < 0.02


def test_held_out_rows_are_shaded_and_logs_stand_one_after_another():
    spans = residual_in_time(named())[0].layers[0]
    flag = np.asarray(named().drawn.held_out) > 0.5
    inside = sum((named().drawn.time >= a) & (named().drawn.time <= b) for a, b in zip(spans.x, spans.y))
    assert spans.kind == "spans" and np.array_equal(inside > 0, flag)
    chart = residual_in_time(one_joint())[0]
    line = chart.layers[1]
    assert "one log after another" in chart.x_label
    assert np.all(np.diff(line.x[np.isfinite(line.x)]) > 0.0) and np.isnan(line.x).sum() == 1


def test_what_has_no_name_may_follow_another_joint(pages):
    e = unnamed()
    e = replace(e, shape=replace(e.shape, axis="velocity of joint 3", axis_unit="rad/s"))
    (chart,) = residual_against(e)
    assert chart.x_label == "velocity of joint 3 [rad/s]"
    assert np.array_equal(chart.layers[0].x, e.drawn.signals["velocity"][:, 2])
    assert "velocity of joint 3 [rad/s]" in page(e)
    assert "time within one period [s]" in pages["remainder"]


def test_whiteness_leaves_out_lag_zero_and_shows_the_bound():
    for chart in whiteness(named()):
        band, stems = chart.layers
        assert np.all(stems.x > 0.0) and np.allclose(band.y2, 1.96 / np.sqrt(2000))
        assert np.all(np.abs(stems.y) < chart.y_range[1])


def test_residuals_without_an_effect_show_no_augmented_model():
    assert len(residual_in_time(nothing())[0].layers) == 3
    assert len(residual_in_time(unnamed())[0].layers) == 4


def test_a_page_of_a_long_record_stays_small():
    e = named()
    joints = tuple(replace(e.effects[0], joint=j) for j in (1, 2, 3))
    text = page(replace(e, effects=joints, drawn=drawn(rows=60000)))
    assert len(text.encode("utf-8")) < 2_000_000


@pytest.mark.parametrize(
    "value, shown",
    [
        (None, "\u2013"),
        (float("nan"), "\u2013"),
        (0.0, "0"),
        (-0.5, "\u22120.500"),
        (14.7, "14.7"),
        (1834.2, "1834"),
        (2.5e-7, "2.50\u00d710\u207b\u2077"),
        (9.999, "10.0"),
    ],
)
def test_numbers_read_well(value, shown):
    assert number(value) == shown


def test_estimates_have_the_digits_that_their_intervals_deserve():
    assert estimate(Interval(9.973, 9.81, 10.14, "N.m")) == ("9.97", "9.81 to 10.14", "N\N{MIDDLE DOT}m")
    assert estimate(Interval(8.1e-4, 7.6e-4, 8.6e-4, "rad")) == ("0.810", "0.760 to 0.860", "mrad")
    # the friction of a small machine
    assert estimate(Interval(5.21e-4, 4.44e-4, 6.41e-4, "N.m")) == ("0.521", "0.444 to 0.641", "mN\N{MIDDLE DOT}m")
    assert estimate(Interval(0.174, 0.16, 0.19, "N.m")) == ("0.174", "0.160 to 0.190", "N\N{MIDDLE DOT}m")
    assert estimate(Interval(2.0, 1.0, np.inf, "1")) == ("2.00", "1.00 to no bound", "")
    assert quantity(1.5e-3, "s") == "1.50\N{NO-BREAK SPACE}ms"


# ------------------------------------------------------------------------------------------- files


def test_a_folder_gets_all_three_files_and_the_model_loads(tmp_path):
    folder = tmp_path / "new" / "folder"
    paths = write_explanation(named(), folder)
    assert [path.name for path in paths] == ["report.json", "report.html", "model.yaml"]
    assert sorted(contents(folder)) == ["model.yaml", "report.html", "report.json"]
    assert load_model(folder / "model.yaml") == named().model
    # a fault has no model, and an earlier one does not stay
    write_explanation(faulty(), folder)
    assert sorted(contents(folder)) == ["report.html", "report.json"]


@pytest.mark.parametrize("name", ["report.json", "report.html", "model.yaml"])
def test_all_files_or_none(name, tmp_path, monkeypatch):
    write_explanation(nothing(), tmp_path)
    before = contents(tmp_path)

    class FullDisk:
        def __init__(self, file):
            self.write = file.write

        def flush(self):
            raise OSError(errno.ENOSPC, "No space left on device")

    @contextmanager
    def whole_file(path, error):
        with files.whole_file(path, error) as file:
            yield FullDisk(file) if path.name == name else file

    monkeypatch.setattr(output, "whole_file", whole_file)
    with pytest.raises(RecordingError, match=f"{name}: cannot be written .No space left"):
        write_explanation(named(), tmp_path)
    assert contents(tmp_path) == before


def test_folders_that_cannot_be_used(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="file: is a file; expected a folder"):
        write_explanation(named(), tmp_path / "file")
    with pytest.raises(RecordingError, match="file is no folder"):
        check_folder(tmp_path / "file" / "below")
    (tmp_path / "report.html").mkdir()
    with pytest.raises(RecordingError, match="report.html: is a folder; expected a file"):
        check_folder(tmp_path)
    model = tmp_path / "other" / "model.yaml"
    model.parent.mkdir()
    model.write_text("")
    with pytest.raises(RecordingError, match="is an input and would be overwritten"):
        check_folder(model.parent, [model])
    check_folder(tmp_path / "other")


# ----------------------------------------------------------------------------------------- browser


@needs_chromium
@pytest.mark.timeout(240)
def test_browser_shows_every_verdict_at_desk_and_phone(tmp_path, pages):
    assert_drawn(pages.values(), tmp_path, least_height=80, least_letters=9.5)


@needs_chromium
@pytest.mark.timeout(240)
def test_browser_opens_and_prints_the_file(tmp_path):
    _, path, _ = write_explanation(tied(), tmp_path / "out")
    _shown, console = browse(path, tmp_path, f"--print-to-pdf={tmp_path / 'report.pdf'}")
    assert console == [] and CHROMIUM
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
