# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The page and the JSON: valid, the same on every run, and drawn as promised in a real browser."""

from __future__ import annotations

import html
import itertools
import json
import re

import numpy as np
import pytest
from browser_support import CHROMIUM, assert_drawn, browse, needs_chromium, outline_of
from cli_support import call, complaints, puma_sim

from puma_sim_core.errors import ParameterError
from puma_sim_core.pages.text import number_text
from puma_sim_core.thesis import registry
from puma_sim_core.thesis.registry import Context, Experiment, experiments, find, run
from puma_sim_core.thesis.report import POINTS, drawn, first_sentence, json_text, page, thin
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Result, Row

#: experiments that take less than a second, with words, numbers and curves in them
QUICK = ("2.4", "4.3", "4.4", "4.5")
HARD = "a < b & \"c\" > 'd' $x$ \\ <script>alert(1)</script> \u00b0"
LONG = "damping ratio of the least damped oscillation of all three joints together [1]"


def made(summary="It works. It is a test.", **parts) -> dict:
    """One experiment that gives this result."""
    result = Result(summary, **parts)
    found = Experiment("7.7.1", "A title", "7.7", lambda context: result)
    return {found.number: (found, result)}


def every_kind() -> dict:
    """A result with each kind of row, curve and figure."""
    x = np.linspace(0.0, 10.0, 5000)
    gap = np.where((x > 3) & (x < 4), np.nan, np.sin(x))
    figures = (
        Figure(
            "7.17",
            "Lines",
            "time [s]",
            "q1 [rad]",
            (
                Curve("line", x, np.sin(x)),
                Curve("gap", x, gap, "dashed"),
                Curve("steps", x[::500], np.cos(x[::500]), "steps"),
                Curve("points", x[::700], np.cos(x[::700]), "points"),
                Curve("one point", [5.0], [0.5]),
            ),
            note=HARD,
        ),
        Figure(
            "own-log",
            "Logarithms",
            "step [s]",
            "error [rad]",
            (Curve("error", 10.0 ** np.arange(-5.0, 0.0), 10.0 ** np.arange(-12.0, -2.0, 2.0)),),
            log_x=True,
            log_y=True,
        ),
        Heatmap(
            "own-map",
            HARD,
            LONG,
            LONG,
            np.arange(4.0),
            np.arange(3.0),
            np.array([[1.0, 2.0, 3.0, 4.0], [2.0, np.nan, 4.0, 5.0], [3.0, 4.0, 5.0, 6.0]]),
            LONG,
        ),
    )
    rows = (
        Row("a number", "V", 7.5, 3.553, "It does not reproduce."),
        Row(HARD, "kg.m^2", None, 1e-16),
        Row("words", "", HARD, "T3\nin two lines"),
        Row("equal", "s", 0.45, 0.4501),
    )
    return made(
        rows=rows,
        figures=figures,
        numbers={"list": [1, None, 2.5], "yes": True},
        page_rows=(Row("run time", "s", 540.0, 0.123, "A faster computer."),),
        page_figures=(Figure("own-time", "Only on the page", "x", "y", (Curve("", [0, 1], [1, 2]),)),),
    )


@pytest.fixture(scope="module")
def quick_results():
    return run([experiments()[number] for number in QUICK], seed=1)


# ----------------------------------------------------------------------------------------- results


def test_a_result_refuses_what_json_and_plots_cannot_hold():
    with pytest.raises(ValueError, match="expected a finite number"):
        Row("q", "V", None, float("nan"))
    with pytest.raises(ValueError, match="'worst'.*expected a finite number"):
        Result("s", numbers={"worst": [1.0, np.inf]})
    with pytest.raises(ValueError, match="expected two equally long"):
        Curve("c", [1.0, 2.0], [1.0])
    with pytest.raises(ValueError, match="expected two equally long, non-empty"):
        Curve("c", [], [])
    with pytest.raises(ValueError, match="style 'wavy'"):
        Curve("c", [1.0], [1.0], "wavy")
    with pytest.raises(ValueError, match=r"expected \(nx,\), \(ny,\), \(ny, nx\)"):
        Heatmap("k", "t", "x", "y", np.arange(3), np.arange(2), np.zeros((3, 2)), "v")


def test_numpy_numbers_become_plain_ones():
    result = Result(
        "s", rows=(Row("q", "V", np.float64(1.5), np.int64(2)),), numbers={"a": np.arange(2), "b": np.bool_(True)}
    )
    assert type(result.rows[0].printed) is float and type(result.rows[0].ours) is int
    assert result.numbers == {"a": [0, 1], "b": True}


def test_random_numbers_depend_on_seed_and_name_alone():
    first = Context(3).rng("noise").random(4)
    assert np.array_equal(first, Context(3).rng("noise").random(4))
    assert not np.array_equal(first, Context(3).rng("other").random(4))
    assert not np.array_equal(first, Context(4).rng("noise").random(4))


# ---------------------------------------------------------------------------------------- registry


def test_experiments_stand_in_the_order_of_the_thesis():
    numbers = list(experiments())
    digits = [tuple(map(int, re.findall(r"\d+", number.split("-")[0]))) for number in numbers if number[0].isdigit()]
    assert digits == sorted(digits)
    assert set(QUICK) <= set(numbers)
    # all names without a number come last
    assert [number[0].isdigit() for number in numbers] == [True] * len(digits) + [False] * (len(numbers) - len(digits))


def test_find_gives_one_or_a_section_and_names_what_there_is():
    assert [each.number for each in find("4.3")] == ["4.3"]
    assert [each.number for each in find("4")] == ["4.3", "4.4", "4.5"]
    with pytest.raises(ParameterError, match=r"no experiment '9.9'; expected .* `puma-sim thesis`"):
        find("9.9")


def test_two_modules_cannot_take_one_number():
    experiments()
    with pytest.raises(ValueError, match="experiment 4.3 stands in"):
        registry.experiment("4.3", "again")(lambda context: None)


# -------------------------------------------------------------------------------------------- JSON


def test_json_holds_everything_and_nothing_that_changes():
    text = json_text(every_kind(), seed=5)

    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    content = json.loads(text, parse_constant=refuse)
    (found,) = content["experiments"]
    assert content["seed"] == 5 and found["number"] == "7.7.1"
    assert [each["quantity"] for each in found["rows"]] == ["a number", HARD, "words", "equal"]
    assert found["rows"][1]["ours"] == 1e-16 and found["rows"][1]["printed"] is None
    assert found["numbers"] == {"list": [1, None, 2.5], "yes": True}
    lines, logs, field = found["figures"]
    assert [curve["label"] for curve in lines["curves"]] == ["line", "gap", "steps", "points", "one point"]
    assert None in lines["curves"][1]["y"] and logs["log_x"] and field["values"][1][1] is None
    assert "run time" not in text and "Only on the page" not in text


@pytest.mark.long
def test_json_is_the_same_on_every_run_and_however_it_is_run(quick_results, tmp_path):
    chosen = [experiments()[number] for number in QUICK]
    again = json_text(run(chosen, seed=1), 1)
    assert json_text(quick_results, 1) == again
    assert json_text(run(chosen, seed=1, jobs=2), 1) == again
    assert json_text(run(chosen, seed=2), 2) != again
    # an experiment alone finds what it finds among others
    alone = json.loads(json_text(run(chosen[:1], seed=1), 1))["experiments"][0]
    assert alone == json.loads(again)["experiments"][0]


@pytest.mark.parametrize("jobs", [1, 2])
def test_progress_goes_from_nought_to_one(jobs):
    seen = []
    run([experiments()[number] for number in QUICK[1:]], 1, jobs, lambda what, share: seen.append(share))
    assert all(a <= b for a, b in itertools.pairwise(seen)) and seen[0] >= 0.0 and seen[-1] <= 1.0


def test_a_failing_experiment_is_named():
    def fail(context):
        raise ZeroDivisionError("no gain")

    with pytest.raises(RuntimeError, match=r"experiment 9.1 \(Broken\) failed: no gain"):
        run([Experiment("9.1", "Broken", "9", fail)], 1)


# ------------------------------------------------------------------------------------------ curves


def test_thinning_keeps_ends_peaks_and_gaps():
    x = np.linspace(0.0, 1.0, 20000)
    y = np.sin(300 * x)
    y[12345], y[777], y[15000:15003] = 9.0, -9.0, np.nan
    tx, ty = thin(Curve("c", x, y))
    assert tx.size <= 1.2 * POINTS and np.all(np.diff(tx) > 0)
    assert (tx[0], tx[-1], np.nanmax(ty), np.nanmin(ty)) == (x[0], x[-1], 9.0, -9.0)
    assert np.isnan(ty).any()
    short = Curve("c", x[:100], y[:100])
    assert thin(short)[0] is short.x


def test_dashed_curves_have_the_colour_of_their_partners():
    figure = Figure(
        "k",
        "t",
        "x",
        "y",
        tuple(Curve(f"{name} {style}", [0, 1], [0, 1], style) for name in "ab" for style in ("line", "dashed")),
    )
    one, one_dashed, two, two_dashed = drawn(figure).layers
    assert one.colour == one_dashed.colour != two.colour == two_dashed.colour
    assert one.dashes != one_dashed.dashes


# -------------------------------------------------------------------------------------------- page


def test_page_stands_alone_and_every_link_in_it_leads_somewhere():
    text = page(every_kind(), seed=1)
    outline = outline_of(text)
    assert len(outline.identifiers) == len(set(outline.identifiers))
    for reference in outline.references:
        assert reference.startswith(("#", "data:")), reference
        if reference.startswith("#"):
            assert reference[1:] in outline.identifiers
    for reference in re.findall(r"url\(([^)]*)\)", text):
        assert reference.strip("'\"").startswith("#"), reference
    assert "script" not in outline.tags and "@import" not in text


def test_page_escapes_and_says_where_numbers_differ():
    text = page(every_kind(), seed=1)
    assert "<script>" not in text
    assert HARD in html.unescape(text)
    assert 'class="mark differs"' in text and 'class="mark agrees"' in text
    assert "kg.m\u00b2" in text and "1\u00d710\u207b\u00b9\u2076" in text
    assert "run time" in text and "Plot 7.17." in text and "Plot own" not in text


def test_page_is_the_same_on_every_run():
    assert page(every_kind(), seed=1) == page(every_kind(), seed=1)


@pytest.mark.parametrize(
    "value, text",
    [
        (None, ""),
        (True, "yes"),
        (3, "3"),
        (-0.5, "\u22120.5"),
        (2.49764, "2.4976"),
        (1.6e-9, "1.6\u00d710^-9"),
        ("about 3", "about 3"),
        (1234567.0, "1.2346\u00d710^6"),
    ],
)
def test_numbers_read_well(value, text):
    assert number_text(value) == text


@pytest.mark.parametrize(
    "printed, ours, expected",
    [
        (7.5, 7.564, False),
        (7.5, 3.553, True),
        (None, 1.0, None),
        ("few", 1.0, None),
        (0, 0.0, False),
        (0.0, 1e-3, True),
    ],
)
def test_differs(printed, ours, expected):
    assert Row("q", "", printed, ours).differs is expected
    assert Row("q", "", printed, ours, agrees=True).differs is False


def test_first_sentence():
    assert first_sentence("One 3.5 V of e.g. two.\nTwo. Three.") == "One 3.5 V of e.g. two."


@pytest.mark.parametrize("number", QUICK)
def test_a_row_that_differs_says_why(quick_results, number):
    for each in quick_results[number][1].rows:
        assert not each.differs or each.note, each.quantity


# ----------------------------------------------------------------------------------------- command


def test_command_lists_runs_and_writes(tmp_path, capsys):
    assert call("thesis") == 0
    listed = capsys.readouterr().out
    assert all(re.search(rf"^{re.escape(number)} ", listed, re.MULTILINE) for number in QUICK)
    out = tmp_path / "new" / "folder"
    assert call("thesis", "4.3", "--out", out) == 0
    shown = capsys.readouterr().out
    assert "D22, equation 4.13 [kg.m^2]" in shown and "thesis-4.3.html" in shown
    assert json.loads((out / "thesis-4.3.json").read_text())["experiments"][0]["number"] == "4.3"
    assert sorted(each.name for each in out.iterdir()) == ["thesis-4.3.html", "thesis-4.3.json"]


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["9.9"], "no experiment '9.9'; expected"),
        (["--all", "4.3"], "expected one of the two"),
        (["4.3", "--seed", "x"], "--seed: 'x'; expected a whole number, 0 or more"),
        (["4.3", "--jobs", "0"], "--jobs: '0'; expected a whole number, 1 or more"),
        (["--out", "x"], "nothing to run for --out"),
    ],
)
def test_command_refuses(arguments, message, capsys):
    assert call("thesis", *arguments) == 2
    assert message in capsys.readouterr().err


def test_command_refuses_a_file_as_folder(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert call("thesis", "4.3", "--out", tmp_path / "file") == 2
    assert "cannot be made" in capsys.readouterr().err


@pytest.mark.long
def test_command_in_a_process_of_its_own_gives_the_same_bytes(tmp_path):
    for name in "ab":
        done = puma_sim("thesis", "2.4", "--out", tmp_path / name, "--seed", "7")
        assert (done.returncode, complaints(done)) == (0, [])
    first, second = ((tmp_path / name / "thesis-2.4.json").read_bytes() for name in "ab")
    assert first == second


# ----------------------------------------------------------------------------------------- browser


@needs_chromium
@pytest.mark.timeout(240)
def test_browser_draws_every_kind_of_figure(tmp_path):
    assert_drawn([page(every_kind(), seed=1)], tmp_path)


@needs_chromium
@pytest.mark.timeout(240)
def test_browser_draws_every_figure_of_the_experiments(tmp_path, quick_results):
    text = page(quick_results, seed=1)
    assert_drawn([text], tmp_path)
    path = tmp_path / "thesis.html"
    path.write_text(text, encoding="utf-8")
    # as a reader opens it: from the disk, with no network
    assert browse(path, tmp_path, "--dump-dom")[1] == []
    assert browse(path, tmp_path, f"--print-to-pdf={tmp_path / 'thesis.pdf'}")[1] == []
    assert (tmp_path / "thesis.pdf").read_bytes().startswith(b"%PDF")


# ---------------------------------------------------------------------------------- all of them


@pytest.mark.thorough
@pytest.mark.timeout(900)
def test_all_experiments_give_one_page_and_the_same_json_twice(tmp_path):
    """Twice: every third experiment again, in one process instead of two."""
    again = list(experiments())[::3]
    for name, options in (("a", ("--all", "--jobs", "2")), ("b", (*again, "--jobs", "1"))):
        done = puma_sim("thesis", *options, "--out", tmp_path / name, patience=400)
        assert (done.returncode, complaints(done)) == (0, [])
    written = [next((tmp_path / name).glob("*.json")) for name in "ab"]
    found, second = (json.loads(path.read_text("utf-8"))["experiments"] for path in written)
    assert [json.dumps(each) for each in found if each["number"] in again] == [json.dumps(each) for each in second]
    assert [each["number"] for each in found] == list(experiments())
    unexplained = [
        (each["number"], row["quantity"])
        for each in found
        for row in each["rows"]
        if row["agrees"] is False and not row["note"]
    ]
    assert unexplained == []
    text = (tmp_path / "a" / "thesis.html").read_text("utf-8")
    outline = outline_of(text)
    assert len(outline.identifiers) == len(set(outline.identifiers))
    if CHROMIUM is not None:
        assert_drawn([text], tmp_path)
        assert browse(tmp_path / "a" / "thesis.html", tmp_path, "--dump-dom")[1] == []
