# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Which hypotheses get a trial: pushes where the fitted model leaves them, and friction whatever the screening says."""

from __future__ import annotations

from types import SimpleNamespace

from loop_logs import pieces, record

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.identify.fitting.prediction import Point, PredictionFit
from puma_sim_core.identify.prepare import library_of
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.screening.short_list import ShortList
from puma_sim_core.plant.mechanism_file import load_mechanism


def test_a_push_is_placed_by_what_the_fitted_model_leaves():
    mechanism = load_mechanism("dfki_pendulum")
    push = parse_effect("impulse:joint=1,torque=-18,time=2.6,width=0.2")
    log = record(mechanism, mechanism.plant(effects=(push,)), 0.05, 2e-5, seconds=4.0)
    problem, _, predictor = pieces(mechanism, log, 0.05, 2e-5, place=0.0)
    point = Point(mechanism.start, ())
    raw = predictor.errors(point.plant(mechanism))
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(raw))
    causal = CausalScreen(fit, point, fit.weighting(raw), fit.whitened(fit.derivatives(point, ())), problem)
    found = causal.score(KINDS["impulse"], 1)
    assert found is not None and found.values is not None and found.gain > 100.0
    assert abs(found.values["time"] - 2.6) < 0.05 and -30.0 < found.values["torque"] < -10.0
    # nothing is placed in rows that are not fitted to
    assert not causal.signals.residual[~fit.rows].any()


class Screen:
    """Scores friction of a joint as illegal, and that of joints that do not move not at all."""

    def score(self, kind, joint):
        return None if joint == 3 else Scored(kind.name, joint, -1.0)


def test_dry_friction_is_tried_where_anything_is_missing_and_none_is_in_the_model():
    mechanism, library = load_mechanism(), library_of(load_mechanism())
    search = SimpleNamespace(library=library)
    short = ShortList(search, SimpleNamespace(mechanism=mechanism), None)

    def tried(found, keys=()):
        return {s.key for s in short._common([Scored(*key, 5.0) for key in found], keys, Screen())}

    both = ("coulomb_friction", "load_dependent_friction")
    assert tried([("joint_elasticity", 2)]) == {(name, 2) for name in both}
    # of the whole arm: on each joint that moves
    assert tried([("input_delay", None)]) == {(name, joint) for name in both for joint in (1, 2)}
    assert tried([]) == set()
    assert tried([("joint_elasticity", 2), ("coulomb_friction", 2)]) == {("load_dependent_friction", 2)}
    assert tried([("joint_elasticity", 2)], [("stribeck_friction", 2)]) == set()
    start = short._common([Scored("joint_elasticity", 2, 5.0)], (), Screen())[0]
    assert start.values == {"torque": mechanism.torque_scale[1]}
