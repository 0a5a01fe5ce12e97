# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Which hypotheses get a trial: pushes where the fitted model leaves them, friction and limits whatever the screening
says."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from loop_logs import pieces, record

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.trials import unseen
from puma_sim_core.identify.prepare import library_of
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.screening.short_list import ShortList
from puma_sim_core.identify.settings import SCREENING
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

    def tried(found, keys=(), stretched=False):
        return {s.key for s in short._common([Scored(*key, 5.0) for key in found], keys, Screen(), stretched)}

    both = ("coulomb_friction", "load_dependent_friction")
    assert tried([("joint_elasticity", 2)]) == {(name, 2) for name in both}
    # friction may hold a joint that does not move
    assert tried([("voltage_dead_band", 3)]) == {(name, 3) for name in both}
    # of the whole arm: on each joint that moves
    assert tried([("input_delay", None)]) == {(name, joint) for name in both for joint in (1, 2)}
    assert tried([]) == set()
    assert tried([("joint_elasticity", 2), ("coulomb_friction", 2)]) == {("load_dependent_friction", 2)}
    assert tried([("joint_elasticity", 2)], [("stribeck_friction", 2)]) == set()
    # parameters that something missing has stretched hide it on any joint
    everywhere = {(name, joint) for name in both for joint in (1, 2, 3)}
    assert tried([("joint_elasticity", 2)], stretched=True) == everywhere
    assert tried([], [("stribeck_friction", 2)], stretched=True) == {key for key in everywhere if key[1] != 2}
    start = short._common([Scored("joint_elasticity", 2, 5.0)], (), Screen(), False)[0]
    assert start.values == {"torque": mechanism.torque_scale[1]}


def test_the_short_list_holds_the_best_of_the_innovations_beside_those_of_the_filtered_motion():
    """What both screenings see takes no place of what one of them sees alone."""
    mechanism = load_mechanism("pendulum")
    search = SimpleNamespace(library=library_of(mechanism))
    short = ShortList(search, SimpleNamespace(mechanism=mechanism, expected=np.ones(1)), None)
    both = ["voltage_saturation", "voltage_dead_band", "impulse", "current_limit"]
    alone = ["transmission_error", "joint_elasticity", "torque_ripple", "sensor_lag", "sensor_nonlinearity"]

    def scored(names):
        return [Scored(name, 1, 100.0 - n, values={}) for n, name in enumerate(names)]

    short._slow = lambda keys, point: scored(both)
    short._fast = lambda keys, causal: scored(both + alone)
    short._related = lambda found, keys, causal: []
    short._common = lambda found, keys, causal, stretched: []
    found = [s.name for s in short.of((), Point(mechanism.start, ()), None)]
    assert found == both + alone[: SCREENING.short_list_fast]


LIMITS, PLAY = ("current_limit", "voltage_saturation"), "backlash"


def limits(*joints):
    """Every limit on joints."""
    return {(name, joint) for name in LIMITS for joint in joints}


@pytest.mark.parametrize(
    "volts, doubted, stretched, taken, keys, tried",
    [
        ([1.0, 1.0, 1.0], (), False, (), (), set()),
        # a voltage that nothing coarse explains may be a limit's; play cannot make such a one
        ([1.0, 1.0, 1.0], (3,), False, (), (), limits(3)),
        # parameters that went farther than their priors allow may have taken up that of any joint
        ([1.0, 1.0, 1.0], (), True, (*limits(1),), (), limits(2, 3)),
        # noise of a far noisier joint may be the impacts of play, but no limit's
        ([1.0, 9.0, 1.0], (), False, (), (), {(PLAY, 2)}),
        ([1.0, 9.0, 1.0], (2,), False, (), (), {*limits(2), (PLAY, 2)}),
        ([1.0, 9.0, 1.0], (2,), False, (*limits(2),), (), {(PLAY, 2)}),
        # a joint with two masses already gets no others
        ([1.0, 9.0, 1.0], (2,), False, (), ((PLAY, 2),), set()),
    ],
)
def test_a_limit_is_tried_on_a_joint_whose_voltage_nothing_coarse_explains(
    volts, doubted, stretched, taken, keys, tried
):
    search, predictor = SimpleNamespace(library=library_of(load_mechanism())), SimpleNamespace(expected=np.array(volts))
    found = [*ShortList(search, predictor, None, doubted)._without_power(taken, keys, stretched)]
    assert {scored.key for scored in found} == tried
    # no gain promised anything: all derivatives are taken anew for a limit, whose level no slope shows
    assert {scored.key for scored in found if unseen(scored)} == {key for key in tried if key[0] in LIMITS}


def test_a_limit_that_was_screened_keeps_its_promise():
    assert all(unseen(Scored(limit, 1, 0.0)) and not unseen(Scored(limit, 1, 0.0, best=object())) for limit in LIMITS)
    assert not unseen(Scored(PLAY, 1, 0.0)) and not unseen(Scored("payload", None, 0.0))


def test_what_contains_the_best_trials_is_asked_for_once():
    short = ShortList(SimpleNamespace(library=KINDS), None, None)
    coulomb, lag = ("coulomb_friction", 2), ("sensor_lag", 2)
    richer = {kind.name for kind in KINDS.values() if "coulomb_friction" in kind.contains}
    found = short.richer({coulomb: 200.0, lag: 20.0}, {coulomb, lag})
    assert found and {joint for _, joint in found} == {2}
    assert {kind.name for kind, _ in found} == richer - {kind for kind in richer if KINDS[kind].screening.generous}
    # not what was tried, nor what contains a trial that gains little, or too little for a name
    first, *others = found
    assert short.richer({coulomb: 200.0, lag: 20.0}, {coulomb, lag, (first[0].name, 2)}) == others
    assert not {kind.name for kind, _ in short.richer({coulomb: 20.0, lag: 200.0}, {coulomb, lag})} & richer
    assert short.richer({coulomb: 10.0}, {coulomb}) == []
