# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a push would gain elsewhere in a log.

A push is placed where most is left, so that shifted innovations say nothing of it: they have the same bump. What a
wrong model leaves has bumps all over the log, and the greatest of them is no push. So a push is compared with the
greatest gain of one in each of n pieces of what is left when it is taken out. Of these let u be the median and s the
median excess over u of the k above it, over ln 2. If they have an exponential tail, as gains have (`surrogates`), the
greatest of n further pieces exceeds

    u + k s ((n / (2 a))^(1/k) - 1)

with probability a, where s is known by k excesses only.

A log may have several pushes, and each would hide the others. So the greatest gains are left out, one by one, up to as
many as a joint may have beside the one, and the least level counts of those that all that are left out are above, with
a share of the probability (after the generalised extreme studentised deviates: Rosner, Technometrics 25 (1983) 165).
"""

from dataclasses import replace

import numpy as np

from puma_sim_core.effects import Kind
from puma_sim_core.identify.arrays import Floats, Ints
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.hypotheses import candidates
from puma_sim_core.identify.settings import SELECTION


def level_of_pieces(gains: Floats, probability: float, further: int = 0) -> float:
    """The gain [nat] that the greatest of as many further pieces exceeds with a probability.

    gains (n,) [nat] : the greatest of each piece; infinite for fewer than two pieces; further : pieces that may have a
    push of their own, at most a quarter of all.
    """
    ordered = np.sort(gains)[::-1]
    found = _level(ordered, probability)
    for out in range(1, min(further, len(gains) // 4) + 1):
        if ordered[out - 1] > _level(ordered[out:], SELECTION.elsewhere_left_out * probability):
            found = min(found, _level(ordered[out:], probability))
    return found


def _level(gains: Floats, probability: float) -> float:
    """`level_of_pieces` where none has a push of its own."""
    n = len(gains)
    if n < 2:
        return np.inf
    edge = float(np.median(gains))
    above = gains[gains > edge]
    if not len(above):
        return edge
    k = len(above)
    scale = float(np.median(above - edge)) / np.log(2.0)
    return edge + k * scale * ((0.5 * n / probability) ** (1.0 / k) - 1.0)


def gains_elsewhere(causal: CausalScreen, kind: Kind, joint: int, piece: Ints) -> Floats:
    """(n,) greatest gains [nat] of an effect that is placed by what is left, in each piece of a log.

    causal : about the model with the effect; joint : 1-based; piece (N,) : number of the piece of each row.
    """
    signals, residual = causal.signals, causal.signals.residual
    assert residual is not None
    found = []
    for number in range(int(piece.max()) + 1):
        inside = np.where((piece == number)[:, None], residual, 0.0)
        if not inside[:, joint - 1].any():
            continue
        own = candidates(kind, joint, replace(signals, residual=inside))
        scored = causal.score_columns(kind.name, joint, [(c, causal.columns(c)) for c in own])
        if scored is not None:
            found.append(scored.gain)
    return np.array(found)


def level_elsewhere(causal: CausalScreen, kind: Kind, joint: int, piece: Ints) -> float:
    """The gain [nat] that such an effect needs, by `gains_elsewhere`."""
    return level_of_pieces(gains_elsewhere(causal, kind, joint, piece), 0.5 * SELECTION.surrogate_level, kind.most - 1)
