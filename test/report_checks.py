# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether a report agrees with itself: `python test/report_checks.py FOLDER/report.json ...` prints contradictions.

Each function takes the mapping of a report.json and yields phrases, one a contradiction.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from puma_sim_core.effects import KINDS
from puma_sim_core.pages.text import scale

Report = Mapping[str, Any]
Key = tuple[str, int | None]


def key(each: Mapping[str, Any]) -> Key:
    """(name, joint)."""
    return each["name"], each["joint"]


def evidence_is_one(report: Report) -> Iterator[str]:
    """An effect has one evidence, in the list of effects and in the ranking; the strongest comes first."""
    rows = {key(row): row for row in report["ranking"]}
    if len(rows) < len(report["ranking"]):
        yield "the ranking has a hypothesis twice"
    effects = {key(effect): effect["evidence"] for effect in report["effects"]}
    if list(effects.values()) != sorted(effects.values(), reverse=True):
        yield "the strongest effect is not the first"
    for found, evidence in effects.items():
        row = rows.get(found)
        if row is None or (row["evidence"], row["verdict"]) != (evidence, "named"):
            yield f"{found}: {evidence} nat as an effect, and {row} in the ranking"
    for found, row in rows.items():
        if row["verdict"] == "named" and found not in effects:
            yield f"{found} is named in the ranking only"


def places_are_one(report: Report) -> Iterator[str]:
    """A hypothesis is named, tied with one effect, ruled out for one effect, or none of these."""
    effects = {key(effect) for effect in report["effects"]}
    verdicts = {key(row): row for row in report["ranking"]}
    seen: dict[Key, str] = {}
    for effect in report["effects"]:
        for tie in map(key, effect["tied_with"]):
            if tie in effects or tie in seen:
                yield f"{tie} is tied with {key(effect)} and {seen.get(tie, 'named')}"
            seen[tie] = f"tied with {key(effect)}"
            row = verdicts.get(tie)
            if row is None or row["verdict"] != "tied" or row["against"] is None or key(row["against"]) != key(effect):
                yield f"{tie} is tied with {key(effect)}, and {row} in the ranking"
            if effect["name"] in KINDS[tie[0]].special_cases and effect["joint"] == tie[1]:
                yield f"{tie} contains {key(effect)}, which is enough, and is called tied"
        for out in effect["ruled_out"]:
            if key(out) in effects or (key(out) in verdicts and key(out) in seen):
                yield f"{key(out)} is ruled out for {key(effect)} and {seen.get(key(out), 'named')}"
            row = verdicts.get(key(out))
            if row is not None:
                seen[key(out)] = f"ruled out for {key(effect)}"
                if row["verdict"] != out["because"]:
                    yield f"{key(out)} is ruled out for two reasons: {row['verdict']}; {out['because']}"
    for found, row in verdicts.items():
        if row["verdict"] == "tied" and not seen.get(found, "").startswith("tied"):
            yield f"{found} is tied with no effect"


def leads_are_differences(report: Report) -> Iterator[str]:
    """How much lower a hypothesis is, is the difference of the two evidences given."""
    effects = {key(effect): effect["evidence"] for effect in report["effects"]}
    for row in report["ranking"]:
        said = re.match(r"lower than .* by (-?\d+) nat", row["verdict"])
        if said and row["against"] is not None:
            lead = effects[key(row["against"])] - row["evidence"]
            if abs(lead - int(said[1])) > 0.51:
                yield f"{key(row)} is said to be lower by {said[1]} nat, which is {lead:.1f} nat"


def excited_where_found(report: Report) -> Iterator[str]:
    """Nothing is named or tied, and not excited; no size found is smaller than the smallest that shows."""
    rows = {key(row): row for row in report["detectability"]}
    for effect in report["effects"]:
        for found in (key(effect), *map(key, effect["tied_with"])):
            if found in rows and rows[found]["size"] == "NOT_EXCITED":
                yield f"{found} is named or tied, and not excited"
        row = rows.get(key(effect))
        if row is None or row["parameter"] not in effect["parameters"] or not isinstance(row["size"], float):
            continue
        value = abs(effect["parameters"][row["parameter"]]["value"])
        inverse = KINDS[effect["name"]].parameter(row["parameter"]).inverse
        if (row["size"] < value if inverse else row["size"] > value) and not math.isclose(
            row["size"], value, rel_tol=1e-6
        ):
            yield f"{key(effect)} of {value:.3g} was found, where {row['size']:.3g} is the smallest that shows"


def experiment_is_for_what_is_open(report: Report) -> Iterator[str]:
    """The next experiment separates an effect from all that is tied with it, else it shows what is not excited."""
    offered = report["next_experiment"]
    shown = {key(e): [t for t in map(key, e["tied_with"]) if _can_be_shown(t)] for e in report["effects"]}
    wanted = [(found, *ties) for found, ties in shown.items() if ties and _can_be_shown(found)]
    separate = () if offered is None else tuple(map(key, offered["separate"]))
    if wanted and separate[:1] and set(separate) != set(wanted[0][:4]):
        yield f"the experiment separates {separate}, and {wanted[0]} are tied"
    if wanted and offered is None:
        yield f"{wanted[0]} are tied, and no experiment is offered"
    if not wanted and len(separate) > 1:
        yield f"the experiment separates {separate}, which are not tied"
    if not wanted and len(separate) == 1:
        rows = {key(row): row["size"] for row in report["detectability"]}
        if rows.get(separate[0]) != "NOT_EXCITED":
            yield f"the experiment is to show {separate[0]}, which this log could have shown"
    for name, joint in separate:
        if (name if joint is None else f"{name}@{joint}") not in offered["command"]:
            yield f"the command leaves out {name}"


def _can_be_shown(found: Key) -> bool:
    kind = KINDS[found[0]]
    return kind.repeatable and kind.screening is not None


def numbers_have_their_state(report: Report) -> Iterator[str]:
    """Numbers of the headline: units that read well, and errors that are those of the validation set in the table."""
    number = r"(-?\d[\d.e+-]*)"
    pairs = rf"from {number} to {number} (V|A)\b"
    shown = [((one, other), unit) for one, other, unit in re.findall(pairs, report["sentence"])]
    alone = re.findall(rf"{number} (rad|m|s|V|A)\b", re.sub(pairs, "", report["sentence"]))
    for values, unit in shown + [((value,), unit) for value, unit in alone]:
        if scale(map(float, values), unit)[0] != 1.0:
            yield f"{' and '.join(values)} {unit} in the headline"
    for where, before, after, unit in re.findall(
        r"of (all joints|joint \d+) (?:falls|goes) from (\S+) to (\S+) (\S*[VA])\b", report["sentence"]
    ):
        volts = report["errors"]["held_out"]["voltage_rms"]
        rows = slice(None) if where == "all joints" else slice(int(where[6:]) - 1, int(where[6:]))
        factor = {"V": 1.0, "A": 1.0}.get(unit, 1e3 if unit[0] == "m" else 1e6)
        for stage, said in (("retuned", before), ("augmented", after)):
            each = volts[stage][rows]
            rms = factor * math.sqrt(sum(x**2 for x in each) / len(each))
            if not math.isclose(float(said), rms, rel_tol=6e-3):
                yield f"{said} {unit} in the headline is {rms:.4g} in the table ({stage})"


def verdict_has_what_it_claims(report: Report) -> Iterator[str]:
    """What a verdict says of effects, curve and errors."""
    verdict, effects, shape = report["verdict"], report["effects"], report["shape"]
    if (verdict in ("NAMED", "NAMED_WITH_REMAINDER")) != bool(effects):
        yield f"{verdict} with {len(effects)} effects"
    if shape is not None and verdict not in ("UNNAMED", "NAMED_WITH_REMAINDER"):
        yield f"{verdict} with a curve of what has no name"
    if not effects and report["errors"]["held_out"] is not None and shape is None:
        position = report["errors"]["held_out"]["position_rms"]
        if position["augmented"] != position["retuned"]:
            yield "nothing was added, and the augmented model has another error than the retuned one"


CHECKS = (
    evidence_is_one,
    places_are_one,
    leads_are_differences,
    excited_where_found,
    experiment_is_for_what_is_open,
    numbers_have_their_state,
    verdict_has_what_it_claims,
)


def contradictions(report: Report) -> list[str]:
    """All that a report says against itself."""
    return [f"{check.__name__}: {phrase}" for check in CHECKS for phrase in check(report)]


if __name__ == "__main__":
    wrong = 0
    for path in sys.argv[1:]:
        found = contradictions(json.loads(Path(path).read_text(encoding="utf-8")))
        wrong += bool(found)
        print(f"{path}: {'; '.join(found) or 'agrees with itself'}")
    sys.exit(wrong > 0)
