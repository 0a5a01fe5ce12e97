# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The scored batch: makes fresh blind records, explains them, prints the table.

  python test/score/run.py                       the score: 390 records, seeds from 920000 on
  python test/score/run.py --development --seed 2300 --count 40
  python test/score/run.py --development --seed 2300 --only case=30 --only nothing=5

An outcome is kept in FOLDER/outcomes.jsonl as soon as it is there, so that a batch that was
interrupted goes on where it stopped, as long as the code is the same. Seeds of development and of
scores are never mixed.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy: one record a process, not one a machine

import argparse
import json
import math
import multiprocessing
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

if __name__ == "__main__" and not __package__:
    # run as a script: the package is this folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    __package__ = "score"

from score import jobs, plan, table
from score.scoring import row_of

#: records, the slowest ones, that are explained again with nothing beside them
_AGAIN = 3


def main(arguments=None) -> int:
    given = _parser().parse_args(arguments)
    seed = (
        given.seed if given.seed is not None else (plan.DEVELOPMENT_SEEDS[0] if given.development else plan.FINAL_SEED)
    )
    wanted = dict(_only(text) for text in given.only) or plan.counts(given.count)
    try:
        plan.check_seeds(seed, sum(wanted.values()), given.development)
    except plan.SeedError as error:
        print(f"score: {error}", file=sys.stderr)
        return 2
    recipes = plan.plan(wanted, seed)
    folder = Path(given.out)
    folder.mkdir(parents=True, exist_ok=True)
    code = jobs.fingerprint()
    done = _kept(folder / "outcomes.jsonl", code)
    left = [recipe for recipe in recipes if _key(recipe) not in done]
    print(
        f"{len(recipes)} records, seeds {seed} to {seed + len(recipes) - 1}, "
        f"{len(recipes) - len(left)} of them explained before",
        flush=True,
    )
    jobs.warm_up()
    with (
        tempfile.TemporaryDirectory(prefix="score-") as records,
        open(folder / "outcomes.jsonl", "a", encoding="utf-8") as kept,
    ):
        kept.write("\n")  # the line before may have been cut short
        count = len(recipes) - len(left)
        for recipe, outcome in _outcomes(left, records, given.processes, not given.skip_small):
            done[_key(recipe)] = outcome
            kept.write(json.dumps({"code": code, "key": _key(recipe), "outcome": outcome}) + "\n")
            kept.flush()
            count += 1
            print(f"{count:4d}/{len(recipes)} {table.line(outcome)}", flush=True)
        alone = [jobs.seconds_alone(recipe, records) for recipe in _slowest(recipes, done)]
    outcomes = [done[_key(recipe)] for recipe in sorted(recipes, key=lambda r: r.seed)]
    rows = [row_of(outcome) for outcome in outcomes if not outcome["skipped"]]
    text = table.text(
        rows,
        title=f"Seeds {seed} to {seed + len(recipes) - 1}"
        + (" (development: no figure to show)" if given.development else ""),
        alone=alone,
    )
    print(f"\n{text}")
    summary = {"seed": seed, "code": code, "development": given.development, "rows": _finite(rows)}
    (folder / "score.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    (folder / "score.txt").write_text(text + "\n", encoding="utf-8")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--count",
        type=int,
        default=plan.COUNT,
        metavar="N",
        help="records, in the shares of the whole score (default %(default)s)",
    )
    parser.add_argument("--seed", type=int, metavar="N", help=f"of the first record (default {plan.FINAL_SEED})")
    parser.add_argument(
        "--development", action="store_true", help="seeds {} to {} instead".format(*plan.DEVELOPMENT_SEEDS)
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="KIND=N",
        help="records of a kind or with an effect; may stand more than once",
    )
    parser.add_argument(
        "--skip-small", action="store_true", help="do not explain records whose effect is too small to be seen"
    )
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    parser.add_argument("--out", default="build/score", metavar="FOLDER")
    return parser


def _slowest(recipes, done) -> list:
    """The recipes whose explanations took longest: two at a time share the cores."""
    timed = [
        (done[_key(recipe)]["seconds"], n)
        for n, recipe in enumerate(recipes)
        if done[_key(recipe)]["seconds"] is not None and recipe.fault is None
    ]
    return [recipes[n] for _, n in sorted(timed, reverse=True)[:_AGAIN]]


def _only(text: str) -> tuple[str, int]:
    kind, _, count = text.partition("=")
    return kind, int(count or 1)


def _key(recipe) -> str:
    return repr(recipe)


def _kept(path: Path, code: str) -> dict[str, dict]:
    """Outcomes of the same code in a file, which may end inside a line."""
    found: dict[str, dict] = {}
    if not path.exists():
        return found
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if entry["code"] == code:
            found[entry["key"]] = entry["outcome"]
    return found


def _outcomes(recipes, folder, processes, small):
    """(recipe, outcome) as they come."""
    if processes <= 1:
        for recipe in recipes:
            yield recipe, _plain(jobs.work(recipe, folder, small))
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("fork")) as pool:
        running = {pool.submit(jobs.work, recipe, folder, small): recipe for recipe in recipes}
        try:
            for future in as_completed(running):
                yield running[future], _plain(future.result())
        finally:
            # after an error nothing that is still waiting is begun
            pool.shutdown(cancel_futures=True)


def _plain(outcome: dict) -> dict:
    """As it would be read back."""
    return json.loads(json.dumps(outcome))


def _finite(value):
    """Numbers that JSON has no word for as texts."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


if __name__ == "__main__":
    sys.exit(main())
