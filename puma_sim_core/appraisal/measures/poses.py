# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Pose characteristics of ISO 9283:1998, clause 7, at the wrist point."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import combinations, pairwise
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from puma_sim_core.appraisal.measure import Measure
from puma_sim_core.appraisal.measures.wrist import Wrist, repeatability, repeated, scatter
from puma_sim_core.appraisal.trials.response import Stop

MEASURES = (
    Measure(
        "pose_accuracy",
        "m",
        "AP: distance from the commanded pose to the barycentre of those attained by one approach; of the worst pose",
        "ISO 9283:1998, 7.2.1",
        "pose",
    ),
    Measure(
        "pose_repeatability",
        "m",
        "RP: mean distance of the poses attained by one approach from their barycentre, and three standard deviations "
        "of it; of the worst pose",
        "ISO 9283:1998, 7.2.2",
        "pose",
    ),
    Measure(
        "multidirectional_variation",
        "m",
        "vAP: greatest distance between the barycentres of two approaches of a pose; of the worst pose",
        "ISO 9283:1998, 7.2.3",
        "pose",
    ),
    Measure(
        "distance_accuracy",
        "m",
        "AD: magnitude of the mean attained distance between two poses visited one after the other, less the "
        "commanded one; of the worst pair",
        "ISO 9283:1998, 7.3",
        "pose",
    ),
    Measure(
        "distance_repeatability",
        "m",
        "RD: three standard deviations of the attained distance; of the worst pair",
        "ISO 9283:1998, 7.3",
        "pose",
    ),
    Measure(
        "stabilisation_time",
        "s",
        "from the arrival of the command, or the first crossing into the band about the attained pose where that is "
        "later, to where the wrist stays within it; mean of the visits, of the worst pose",
        "ISO 9283:1998, 7.4",
        "pose",
    ),
    Measure(
        "pose_overshoot",
        "m",
        "OV: greatest distance from the attained pose after that crossing, 0 where it stays within the band; mean of "
        "the visits, of the worst pose",
        "ISO 9283:1998, 7.5",
        "pose",
    ),
)


class Visit(NamedTuple):
    """A stop as it was made: commanded and attained (3,) [m], stabilisation [s], overshoot [m]."""

    stop: Stop
    commanded: np.ndarray
    attained: np.ndarray
    stabilisation: float
    overshoot: float


def visit(wrist: Wrist, stop: Stop) -> Visit:
    """How a stop was made. The attained pose is that at the end of the stop, when the command leaves again."""
    leaves = wrist.row(stop.until)
    attained = wrist.position[leaves]
    distance = wrist.squared_distance(attained, stop.at, stop.until)
    band = stop.band**2
    entered = distance.first_below(band)
    left = distance.last_beyond(band, entered)
    greatest = distance.extremes(entered)[1]
    return Visit(
        stop,
        wrist.commanded[leaves],
        attained,
        0.0 if left == -inf else left - entered,
        sqrt(greatest) if left != -inf else 0.0,
    )


def _key(stop: Stop) -> tuple[int, int]:
    return stop.pose, stop.approach


def pose_names(stops: Sequence[Stop], trials: int) -> list[str]:
    """Names of the measures that stops give over so many trials."""
    ordered = sorted(stops, key=lambda stop: stop.at)
    clusters = Counter(map(_key, ordered))
    pairs = Counter((_key(one), _key(other)) for one, other in pairwise(ordered) if one.pose != other.pose)
    names = ["pose_accuracy", "stabilisation_time", "pose_overshoot"] * bool(clusters)
    names += ["pose_repeatability"] * repeated(clusters, trials)
    names += ["multidirectional_variation"] * (len({pose for pose, _ in clusters}) < len(clusters))
    return names + ["distance_accuracy"] * bool(pairs) + ["distance_repeatability"] * repeated(pairs, trials)


def measure_poses(wrists: Sequence[Wrist], stops: Sequence[Stop]) -> dict[str, float]:
    """Of the stops of one response or of several of the same task; those that need repetitions only where there are."""
    made = [[visit(wrist, stop) for stop in sorted(stops, key=lambda stop: stop.at)] for wrist in wrists]
    clusters: dict[tuple[int, int], list[Visit]] = defaultdict(list)
    pairs: dict[tuple[tuple[int, int], tuple[int, int]], list[tuple[Visit, Visit]]] = defaultdict(list)
    for visits in made:
        for one in visits:
            clusters[_key(one.stop)].append(one)
        for one, next_one in pairwise(visits):
            if one.stop.pose != next_one.stop.pose:
                pairs[_key(one.stop), _key(next_one.stop)].append((one, next_one))
    centres = {key: np.mean([v.attained for v in visits], axis=0) for key, visits in clusters.items()}
    found: dict[str, list[float]] = defaultdict(list)
    for key, visits in clusters.items():
        found["pose_accuracy"].append(float(np.linalg.norm(centres[key] - visits[0].commanded)))
        found["stabilisation_time"].append(float(np.mean([v.stabilisation for v in visits])))
        found["pose_overshoot"].append(float(np.mean([v.overshoot for v in visits])))
        if len(visits) > 1:
            found["pose_repeatability"].append(repeatability([v.attained for v in visits]))
    for (a, centre), (b, other) in combinations(centres.items(), 2):
        if a[0] == b[0]:
            found["multidirectional_variation"].append(float(np.linalg.norm(centre - other)))
    for both in pairs.values():
        attained = [float(np.linalg.norm(one.attained - other.attained)) for one, other in both]
        commanded = float(np.linalg.norm(both[0][0].commanded - both[0][1].commanded))
        found["distance_accuracy"].append(abs(float(np.mean(attained)) - commanded))
        if len(attained) > 1:
            found["distance_repeatability"].append(3.0 * scatter(attained))
    return {name: max(values) for name, values in found.items()}
