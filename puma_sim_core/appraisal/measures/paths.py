# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Path characteristics of ISO 9283:1998, clause 8, at the wrist point."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from puma_sim_core.appraisal.measure import Measure
from puma_sim_core.appraisal.measures.wrist import Wrist, repeatability, repeated, scatter
from puma_sim_core.appraisal.trials.response import Path
from puma_sim_core.control.curve import Curve, cubic_at, cubic_root, cubic_slope
from puma_sim_core.errors import ParameterError

#: points along a path at which it is judged; the standard leaves their number to the user
POINTS = 40
MEASURES = (
    Measure(
        "path_accuracy",
        "m",
        f"AT: at {POINTS} points of the commanded path, the distance to the barycentre of the places where the "
        "attained paths pass the plane normal to it there; the greatest",
        "ISO 9283:1998, 8.2",
        "path",
    ),
    Measure(
        "path_repeatability",
        "m",
        "RT: at the same points the mean distance of those places from their barycentre, and three standard deviations "
        "of it; the greatest",
        "ISO 9283:1998, 8.3",
        "path",
    ),
    Measure(
        "corner_rounding",
        "m",
        "CR: smallest distance of the attained path from the corner; mean of the passes, of the worst corner",
        "ISO 9283:1998, 8.5",
        "path",
    ),
    Measure(
        "corner_overshoot",
        "m",
        "CO: greatest distance of the attained path from the line behind the corner, on its far side; mean of the "
        "passes, of the worst corner",
        "ISO 9283:1998, 8.5",
        "path",
    ),
    Measure(
        "path_speed_accuracy",
        "1",
        "AV: magnitude of the mean attained speed less the commanded one, as a share of it; of the worst path",
        "ISO 9283:1998, 8.6",
        "path",
    ),
    Measure(
        "path_speed_repeatability",
        "1",
        "RV: three standard deviations of the passes' mean speeds, as a share of the commanded one; of the worst path",
        "ISO 9283:1998, 8.6",
        "path",
    ),
    Measure(
        "path_speed_fluctuation",
        "m/s",
        "FV: greatest less smallest speed of a pass, at the same points; the greatest",
        "ISO 9283:1998, 8.6",
        "path",
    ),
)


class Pass(NamedTuple):
    """One pass of a path: where and how fast it goes through the normal planes, and commanded points, (m, 3), (m,)."""

    places: np.ndarray
    speeds: np.ndarray
    points: np.ndarray


def pass_of(wrist: Wrist, path: Path) -> Pass | None:
    """The pass of a path; None where a normal plane is never passed.

    The points are rows of the commanded path, evenly spaced in time from `start` to `until`; the tangent is that of the
    chord through the rows beside. Places are looked for from half the path's time before it to as long behind it; of
    several in a plane that nearest to the commanded point counts.

    Raises ParameterError: a path of too few rows, or one on which the command stands still.
    """
    first, last = max(wrist.row(path.start), 1), min(wrist.row(path.until), len(wrist.time) - 2)
    if last - first < 2:
        what, where = f"path from {path.start:.6g} to {path.until:.6g} s", "measures at the wrist"
        raise ParameterError(what, where=where, expected="three rows at least within the response")
    rows = np.unique(np.linspace(first, last, POINTS).round().astype(int))
    points, tangents = wrist.commanded[rows], wrist.commanded[rows + 1] - wrist.commanded[rows - 1]
    if not np.linalg.norm(tangents, axis=1).min() > 0.0:
        raise ParameterError(
            f"path {path.path} stands still", where="measures at the wrist", expected="a path that moves"
        )
    half = 0.5 * (path.until - path.start)
    nearby = np.flatnonzero((wrist.time >= path.start - half) & (wrist.time <= path.until + half))
    # without the threads of a matrix product: several trials run side by side
    ahead = np.einsum("mk,nk->mn", tangents, wrist.position[nearby]) >= (tangents * points).sum(axis=1)[:, None]
    passed = np.empty(len(rows), dtype=int)
    for n, side in enumerate(ahead):
        k = nearby[:-1][side[1:] != side[:-1]]
        if not k.size:
            return None
        passed[n] = k[np.argmin(np.linalg.norm(wrist.position[k] - points[n], axis=1))]
    c, length = wrist.rows(passed)
    across = ((c - np.array([1.0, 0.0, 0.0, 0.0])[:, None, None] * points) * tangents).sum(axis=2)
    share = cubic_root(across, np.zeros(len(rows)), np.ones(len(rows)))[:, None]
    speeds = np.linalg.norm(cubic_slope(c, share) / length, axis=1)
    return Pass(cubic_at(c, share), speeds, points)


def corner_of(wrist: Wrist, path: Path) -> tuple[float, float]:
    """(CR, CO) of one pass [m]: nearest to the corner, and farthest outside behind it.

    The directions of the two lines are those of the commanded path at its start and end.
    """
    assert path.corner is not None
    start, turn, end = (wrist.row(t) for t in (path.start, path.corner, path.until))
    corner = wrist.commanded[turn]
    before, after = corner - wrist.commanded[start], wrist.commanded[end] - corner
    along = after / np.linalg.norm(after)
    outward = before - (before @ along) * along
    near = sqrt(max(wrist.squared_distance(corner, path.start, path.until).extremes()[0], 0.0))
    away, moving = wrist.position[start : end + 1] - corner, wrist.velocity[start : end + 1]
    across, drift = (a - (a @ along)[:, None] * along for a in (away, moving))
    time = wrist.time[start : end + 1]
    beyond = Curve(time, (across**2).sum(axis=1), 2.0 * (across * drift).sum(axis=1))
    sides = [np.interp(beyond.times, time, away @ direction) > 0.0 for direction in (outward, along)]
    far = beyond.values[sides[0] & sides[1]]
    return near, sqrt(float(far.max())) if far.size else 0.0


def path_names(paths: Sequence[Path], trials: int) -> list[str]:
    """Names of the measures that paths give over so many trials."""
    passes = Counter(path.path for path in paths if path.corner is None)
    names = ["path_accuracy", "path_speed_accuracy", "path_speed_fluctuation"] * bool(passes)
    names += ["path_repeatability", "path_speed_repeatability"] * repeated(passes, trials)
    return names + ["corner_rounding", "corner_overshoot"] * any(path.corner is not None for path in paths)


def measure_paths(wrists: Sequence[Wrist], paths: Sequence[Path]) -> dict[str, float]:
    """Of the passes in responses of the same task; what needs repetitions only where there are."""
    passes: dict[int, list[Pass | None]] = defaultdict(list)
    corners: dict[int, list[tuple[float, float]]] = defaultdict(list)
    speeds: dict[int, float] = {}
    for wrist in wrists:
        for path in paths:
            if path.corner is None:
                passes[path.path].append(pass_of(wrist, path))
                speeds[path.path] = path.speed
            else:
                corners[path.path].append(corner_of(wrist, path))
    found: dict[str, list[float]] = defaultdict(list)
    for both in corners.values():
        for name, value in zip(("corner_rounding", "corner_overshoot"), np.mean(both, axis=0)):
            found[name].append(float(value))
    for number, made in passes.items():
        for name, value in _of_passes(made, speeds[number]).items():
            found[name].append(value)
    return {name: max(values) for name, values in found.items()}


def _of_passes(made: Sequence[Pass | None], speed: float) -> dict[str, float]:
    complete = [one for one in made if one is not None]
    names = ["path_accuracy", "path_speed_accuracy", "path_speed_fluctuation"]
    names += ["path_repeatability", "path_speed_repeatability"] * (len(made) > 1)
    if len(complete) < len(made):
        return dict.fromkeys(names, inf)
    places = np.array([one.places for one in complete])
    means = [float(one.speeds.mean()) for one in complete]
    found = {
        "path_accuracy": float(np.linalg.norm(places.mean(axis=0) - complete[0].points, axis=1).max()),
        "path_speed_accuracy": abs(float(np.mean(means)) - speed) / speed,
        "path_speed_fluctuation": max(float(one.speeds.max() - one.speeds.min()) for one in complete),
    }
    if len(made) > 1:
        found["path_repeatability"] = max(repeatability(list(at)) for at in places.transpose(1, 0, 2))
        found["path_speed_repeatability"] = 3.0 * scatter(means) / speed
    return found
