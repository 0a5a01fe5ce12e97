# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The table of a batch as text, and the line of one record."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

from score.rates import clopper_pearson, wilson
from score.scoring import LEAST_SIZE, ROW_TOLERANCE, kind_of, row_of

BASELINES = ("retuning", "all at once", "forward")
_CLASSES = ((0.6, 1.0), (1.0, 1.5), (1.5, 3.0), (3.0, 6.0), (6.0, math.inf))
_LABEL, _OWN, _BAR, _OTHER = 47, 28, 10, 15


def line(outcome: dict) -> str:
    """One record in a line or two: what was there, what was said, and, where that was wrong, the
    ranking behind it."""
    answer = outcome["answer"]
    effects = " + ".join(
        f"{_named(e['name'], e['joint'])} size {e['size']:.2g} (distinct {e['distinct_size']:.2g})"
        for e in answer["effects"]
    )
    kind = kind_of(answer)
    if kind == "outside":
        o = answer["outside"]
        effects = f"outside: {_named(o['what'], o['joint'])} over {o['axis']} size {answer['size']}"
    elif kind == "fault":
        effects = "fault: " + "; ".join(f"{f['channel']} row {f['row']} {f['what']}" for f in answer["faults"])
    head = f"{outcome['record']} [{_driven(answer)}] {effects or 'nothing missing'}"
    if outcome["skipped"]:
        return f"{head}: too small, left out"
    row = row_of(outcome)
    said = ", ".join(_named(*each) for each in row["said"])
    text = f"{head} -> {row['verdict']} {said} ({row['seconds']} s)"
    if row["kind"] == "fault":
        text += "" if all(row["fault"]) else f"   WRONG verdict, channel, row: {row['fault']}"
        if outcome["report"]:
            text += "".join(
                f"\n          {f['channel']} row {f['row']}: {f['what'][:110]}" for f in outcome["report"]["faults"][:2]
            )
        return text + (f"\n          {outcome['error']}" if outcome["error"] else "")
    if outcome["error"]:
        return f"{text}   WRONG\n          {outcome['error']}"
    if row.get("ratio") is not None:
        text += f" held-out/true {row['ratio']:.3f}"
    if row["kind"] == "outside":
        text += f" shape {row['shape']}"
    if not _right(row):
        first = outcome["report"]["ranking"][:6]
        ranking = "; ".join(
            f"{_named(r['name'], r['joint'])} {r['evidence']:.1f}{'' if len(r['verdict']) > 40 else ' ' + r['verdict']}"
            for r in first
        )
        text += f"   WRONG\n          ranking: {ranking}"
    missed = [name for name, held in row.get("coverage", ()) if not held]
    return text + (f"\n          intervals miss {', '.join(missed)}" if missed else "")


def _driven(answer: dict) -> str:
    return " ".join(
        [
            f"{answer['sampling_ms']:.2g} ms",
            str(answer["motion"]),
            "feedback" if answer["feedback"] else "open loop",
            f"dither {answer['dither']}" if answer["dither"] else "no dither",
        ]
    )


def _named(name: str, joint: int | None) -> str:
    return name if joint is None else f"{name} {joint}"


def _right(row: dict) -> bool:
    """Whether all of a record is as it should be."""
    return {
        "nothing": lambda: not row["alarm"],
        "single": lambda: row["exact"] and not row["needless"],
        "pair": lambda: row["both"] and not row["needless"],
        "outside": lambda: row["abstained"] and row["axis_right"] and row["shape_joint"],
        "fault": lambda: all(row["fault"]),
    }[row["kind"]]()


def text(rows: list[dict], title: str = "", alone: Sequence[float] = ()) -> str:
    """The whole table. alone : seconds of the slowest records when nothing runs beside them."""
    of = {
        kind: [row for row in rows if row["kind"] == kind] for kind in ("nothing", "single", "pair", "outside", "fault")
    }
    seen = [row for row in of["single"] if row["size"] >= LEAST_SIZE]
    pairs = [row for row in of["pair"] if row["size"] >= LEAST_SIZE]
    small = len(of["single"]) - len(seen) + len(of["pair"]) - len(pairs)
    out = [title, "", _head()]
    strong = [row for row in seen if row["size"] >= 1.5]
    weak = [row for row in seen if row["size"] < 1.5]
    out += [
        _share("right name first, size 1.5 and more", strong, "top1", ">= 97 %"),
        _share("right name first, size 0.6 to 1.5", weak, "top1", ">= 90 %"),
        _share("right name and joint first, 0.6 and more", seen, "exact"),
        _share("named, or tied with a name, 0.6 and more", seen, "tie_aware"),
        _share(
            "right joint of the first name", [r for r in seen if r["named"]], "joint_right", ">= 99 %", among="named"
        ),
        _share("needless names (also of pairs)", seen + pairs, "needless", "<= 3 %"),
        _share("alarms where nothing is missing", of["nothing"], "alarm", "<= 2 %"),
        _share("  of them false names", of["nothing"], "false_name"),
        _share("pairs: both", pairs, "both", ">= 90 %"),
        _share("pairs: one at least", pairs, "one"),
        _share("outside the library: unnamed or remainder", of["outside"], "abstained", ">= 95 %"),
        _share(
            "  axis and joint of its shape",
            of["outside"],
            lambda row: row["axis_right"] and row["shape_joint"],
            ">= 90 %",
        ),
        _share("faults: verdict", of["fault"], lambda row: row["fault"][0], "100 %"),
        _share("  channel", of["fault"], lambda row: row["fault"][1], "100 %"),
        _share(f"  row (within {ROW_TOLERANCE})", of["fault"], lambda row: row["fault"][2], "100 %"),
    ]
    inside = [held for row in seen + pairs for _, held in row["coverage"]]
    out.append(_counted("95 % intervals that hold the truth", sum(inside), len(inside), "90-98 %"))
    out += _ratios("held-out error / true structure: median", seen + pairs, 0.5, "<= 1.15")
    out += _ratios("  90 % of the records are below", seen + pairs, 0.9)
    out += _ratios("  mean, where nothing is missing", of["nothing"], None)
    worse = [row for row in rows if row.get("worse") is not None]
    out.append(_share("named, and held out worse than retuned", worse, "worse", "0"))
    out.append(_share("  in the quarter that no choice has seen", worse, "unseen_worse"))
    out.append(_share("    and the true structure is not", worse, "only_here"))
    seconds = sorted(row["seconds"] for row in rows if row["seconds"] is not None and row["kind"] != "fault")
    if seconds:
        out.append(
            _row("seconds a record: median, worst", f"{_quantile(seconds, 0.5):.1f}, {seconds[-1]:.1f}", "15; <= 60")
        )
    if alone:
        out.append(_row("  the slowest again, each alone", ", ".join(f"{each:.1f}" for each in alone), "<= 60"))
    memory = [row["megabytes"] for row in rows if row.get("megabytes")]
    if memory:
        out.append(_row("memory of a process [MB]", str(max(memory)), "< 2000"))
    errors = [row for row in rows if row["error"] is not None and row["kind"] != "fault"]
    out.append(_row("records that ended in an error", str(len(errors)), "0"))
    alarms = sum(row["alarm"] for row in of["nothing"])
    low, high = clopper_pearson(alarms, len(of["nothing"]))
    out += [
        "",
        f"In brackets: Wilson's 95 % interval; alarms by Clopper and Pearson: {100 * low:.1f} to {100 * high:.1f} %.",
        f"Left out of accuracy: {small} records whose effect has a size below {LEAST_SIZE}.",
    ]
    out += _by_size("size", seen) + _by_size(
        "distinct_size", [r for r in seen if r["truth"][0][0] != "coulomb_friction"]
    )
    return "\n".join(
        out
        + _by_parameter(seen + pairs)
        + _by_effect([row for row in seen if row["case"] is None])
        + _by_case([row for row in seen + pairs if row["case"] is not None])
        + _by_what("outside the library", of["outside"])
        + _by_what("faults", of["fault"])
        + _misses(row for row in rows if row["kind"] not in ("single", "pair") or row["size"] >= LEAST_SIZE)
    )


def _head() -> str:
    return f"{'':{_LABEL}}{'here':{_OWN}}{'wanted':{_BAR}}" + "".join(f"{name:>{_OTHER}}" for name in BASELINES)


def _row(label: str, own: str, bar: str = "", others: Iterable[str] = ()) -> str:
    return (f"{label:{_LABEL}}{own:{_OWN}}{bar:{_BAR}}" + "".join(f"{value:>{_OTHER}}" for value in others)).rstrip()


def _counted(label: str, right: int, count: int, bar: str = "", others: Iterable[str] = ()) -> str:
    if not count:
        return _row(label, "-", bar)
    low, high = wilson(right, count)
    own = f"{right}/{count} {100 * right / count:.1f} % [{100 * low:.0f}, {100 * high:.0f}]"
    return _row(label, own, bar, others)


def _share(label: str, rows: list[dict], what: str | Callable, bar: str = "", among: str | None = None) -> str:
    """Share of rows of which `what` (a key or a function) holds, with that of the baselines."""
    take = what if callable(what) else lambda row: row[what]
    others = []
    if isinstance(what, str):
        for name in BASELINES:
            made = [row["baselines"][name] for row in rows if name in row["baselines"]]
            made = [b for b in made if what in b and (among is None or b[among])]
            others.append(f"{100 * sum(b[what] for b in made) / len(made):.1f} %" if made else "-")
    return _counted(
        label,
        sum(bool(take(row)) for row in rows),
        len(rows),
        bar,
        others if any(other != "-" for other in others) else (),
    )


def _ratios(label: str, rows: list[dict], share: float | None, bar: str = "") -> list[str]:
    def shown(values):
        values = sorted(value for value in values if value is not None)
        if not values:
            return "-"
        value = sum(values) / len(values) if share is None else _quantile(values, share)
        return f"{value:.3f}" if math.isfinite(value) else "diverges"

    own = shown(row["ratio"] for row in rows)
    return [
        _row(
            label, own, bar, (shown(row["baselines"].get(name, {}).get("ratio") for row in rows) for name in BASELINES)
        )
    ]


def _quantile(values: list[float], share: float) -> float:
    """Linear between sorted values, as NumPy does it; infinite where either neighbour is."""
    place = share * (len(values) - 1)
    low, part = int(place), place - int(place)
    high = values[min(low + 1, len(values) - 1)]
    return values[low] if part == 0.0 else (1.0 - part) * values[low] + part * high


def _by_size(key: str, rows: list[dict]) -> list[str]:
    out = [
        "",
        f"Right name first, by {key}"
        + (" (of what Coulomb friction besides does not absorb either)" if key != "size" else ""),
    ]
    low = [row for row in rows if row[key] < LEAST_SIZE]
    if low:
        out.append(_share(f"  below {LEAST_SIZE}", low, "top1"))
    for least, most in _CLASSES:
        label = f"  {least:g} to {most:g}" if math.isfinite(most) else f"  {least:g} and more"
        out.append(_share(label, [r for r in rows if least <= r[key] < most], "top1"))
    return out


def _by_parameter(rows: list[dict]) -> list[str]:
    held: dict[str, list[bool]] = {}
    for row in rows:
        for name, inside in row["coverage"]:
            held.setdefault(name, []).append(inside)
    return [
        "",
        "Intervals that hold the truth, by parameter",
        *(_row(f"  {name}", f"{sum(inside)}/{len(inside)}") for name, inside in sorted(held.items())),
    ]


def _by_effect(rows: list[dict]) -> list[str]:
    out = ["", f"By effect, size {LEAST_SIZE} and more: right name and joint / all, and what was said instead"]
    for name in sorted({row["what"] for row in rows}):
        own = [row for row in rows if row["what"] == name]
        instead = Counter(_instead(row) for row in own if not row["exact"])
        out.append(
            _row(f"  {name}", f"{sum(row['exact'] for row in own)}/{len(own)}").ljust(_LABEL + 8)
            + "; ".join(f"{said} ({count})" if count > 1 else said for said, count in instead.most_common())
        )
    return [line.rstrip() for line in out]


def _by_case(rows: list[dict]) -> list[str]:
    out = ["", f"By case (test/blind/cases.py), size {LEAST_SIZE} and more: all right / all"]
    for case in sorted({row["case"] for row in rows}):
        own = [row for row in rows if row["case"] == case]
        out.append(_row(f"  {case}", f"{sum(map(_right, own))}/{len(own)}"))
    return out


def _misses(rows: Iterable[dict]) -> list[str]:
    """Every record that is not as it should be, with its seed."""
    out = ["", "Every miss: record (its number is the seed), what was there, its size, what was said"]
    for row in rows:
        if _right(row):
            continue
        truth = " + ".join(_named(*each) for each in row["truth"]) or row["what"]
        size = "" if row["size"] is None else f" size {row['size']:.2g}"
        case = f" [{row['case']}]" if row["case"] else ""
        said = ", ".join(_named(*each) for each in row["said"])
        out.append(f"  {row['record']}{case} {truth}{size} -> {row['verdict']} {said}".rstrip())
    return out if len(out) > 2 else [*out, "  none"]


def _instead(row: dict) -> str:
    if not row["said"]:
        return row["verdict"]
    (name, joint), (true, _) = row["said"][0], row["truth"][0]
    return f"joint {joint}" if name == true else name


def _by_what(label: str, rows: list[dict]) -> list[str]:
    out = ["", f"By kind, {label}: right / all, and what was said instead"]
    for what in sorted({row["what"] for row in rows}):
        own = [row for row in rows if row["what"] == what]
        wrong = [row for row in own if not _right(row)]
        said = Counter(
            f"{row['verdict']} {', '.join(_named(*e) for e in row['said'])}{row.get('shape') or row.get('fault') or ''}"
            for row in wrong
        )
        out.append(_row(f"  {what}", f"{len(own) - len(wrong)}/{len(own)}").ljust(_LABEL + 8) + "; ".join(said))
    return [line.rstrip() for line in out]
