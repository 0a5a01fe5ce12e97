# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The experiments of the thesis, run again on the corrected model.

  puma-sim thesis                     list them
  puma-sim thesis 7.7.1               run one and print its numbers beside the printed ones
  puma-sim thesis 7.7 --out DIR       all of a section, with a page of the redrawn plots
  puma-sim thesis --all --out DIR     all of them, as one page and one JSON file

The same seed gives the same JSON file, to the byte.
"""

from __future__ import annotations

import argparse
import os
import shutil
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from puma_sim_core.cli.arguments import Command, whole_number
from puma_sim_core.cli.output import Progress, add_force_argument, check_output, output_file
from puma_sim_core.errors import ParameterError, RecordingError

if TYPE_CHECKING:
    from puma_sim_core.thesis.registry import Experiment
    from puma_sim_core.thesis.result import Result, Row


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "number",
        metavar="NUMBER",
        nargs="*",
        help="section of the thesis, such as 7.7.1, or 7.7 for all of it; without one, the list",
    )
    parser.add_argument("--all", action="store_true", help="run all of them")
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="folder for the page (HTML, needs no network) and the numbers (JSON); made if it does not exist",
    )
    parser.add_argument(
        "--seed", metavar="N", default="1", help="whole number from which all that is random follows (default 1)"
    )
    add_force_argument(parser)
    parser.add_argument("--jobs", metavar="N", help="processes at a time (default: as many as there are cores)")


def run(options: argparse.Namespace) -> int:
    """List or run; raises ParameterError or RecordingError."""
    from puma_sim_core.thesis.registry import experiments, find

    seed = whole_number(options.seed, "--seed", 0)
    jobs = _cores() if options.jobs is None else whole_number(options.jobs, "--jobs", 1)
    if options.all and options.number:
        raise ParameterError(f"--all and {' '.join(options.number)}", where="thesis", expected="one of the two")
    if not options.all and not options.number:
        if options.out is not None:
            raise ParameterError("nothing to run for --out", where="thesis", expected="a section or --all")
        _list(list(experiments().values()))
        return 0
    if options.all:
        chosen = list(experiments().values())
    else:
        chosen = list({each.number: each for number in options.number for each in find(number)}.values())
    if options.out is None:
        _print(_results(chosen, seed, jobs))
        return 0
    return _write(options, chosen, seed, jobs)


def _write(options: argparse.Namespace, chosen: list[Experiment], seed: int, jobs: int) -> int:
    from puma_sim_core.thesis.report import json_text, page

    folder = Path(options.out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        what, expected = f"cannot be made ({reason.strerror})", "a folder for the page and the numbers"
        raise RecordingError(what, where=str(folder), expected=expected) from None
    stem = "thesis" if options.all else "-".join(["thesis", *options.number])
    paths = [folder / f"{stem}.html", folder / f"{stem}.json"]
    for path in paths:
        check_output(str(path), force=options.force)
    results = _results(chosen, seed, jobs)
    if not options.all:
        _print(results)
    with Progress() as shown:
        texts = (page(results, seed, lambda share: shown("drawing", share)), json_text(results, seed))
    for path, text in zip(paths, texts):
        with output_file(str(path)) as file:
            file.write(text)
        print(path)
    return 0


def _results(chosen: list[Experiment], seed: int, jobs: int) -> dict[str, tuple[Experiment, Result]]:
    from puma_sim_core.thesis.registry import run as run_experiments

    with Progress() as shown:
        return run_experiments(chosen, seed, jobs, shown)


def _list(found: list[Experiment]) -> None:
    width = max(len(each.number) for each in found)
    for each in found:
        print(f"{each.number:{width}}  {each.title}")


def _print(results: dict[str, tuple[Experiment, Result]]) -> None:
    wide = min(110, max(60, shutil.get_terminal_size((100, 24)).columns))
    for index, (found, result) in enumerate(results.values()):
        title = f"{found.number}  {found.title}"
        print(f"{chr(10) if index else ''}{title}\n{'=' * len(title)}\n")
        print("\n\n".join(textwrap.fill(" ".join(part.split()), wide) for part in result.summary.split("\n\n")))
        rows = (*result.rows, *result.page_rows)
        if rows:
            heads = ("printed", "correct") if found.number == "errata" else ("thesis", "ours")
            print(f"\n{_table(rows, wide, heads)}")


def _table(rows: tuple[Row, ...], wide: int, heads: tuple[str, str]) -> str:
    from puma_sim_core.pages.text import number_text

    column = max(12, min(22, (wide - 36) // 2))
    first = wide - 2 * (column + 2)
    lines = [f"{'':{first}}  {heads[0]:<{column}}  {heads[1]}", "-" * wide]
    for row in rows:
        unit = f" [{row.unit}]" if row.unit not in ("", "1") else ""
        cells = [
            _wrapped(text, width)
            for text, width in (
                (row.quantity + unit, first),
                (number_text(row.printed), column),
                (number_text(row.ours), column),
            )
        ]
        for i in range(max(map(len, cells))):
            left, middle, right = (cell[i] if i < len(cell) else "" for cell in cells)
            lines.append(f"{left:{first}}  {middle:{column}}  {right}".rstrip())
        if row.note:
            lines.append(textwrap.fill(row.note, wide, initial_indent="    ", subsequent_indent="    "))
    return "\n".join(lines)


def _wrapped(text: str, width: int) -> list[str]:
    if "\n" in text:
        # a matrix, with its columns one below the other
        return text.split("\n")
    return textwrap.wrap(text, width) or [""]


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


COMMAND = Command(
    "thesis", "list or run the experiments of the thesis, with a page of the results", __doc__, add_arguments, run
)
