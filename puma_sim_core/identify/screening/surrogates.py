# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What chance gives: the gain of log evidence that surrogate data exceed with a given probability.

Surrogates are the innovations of a log, shifted in a circle (`causal.Placebos`). A gain is half a chi-square less an
Occam factor, so its upper tail, and that of the greatest of many, is exponential: a generalised Pareto distribution of
shape 0 (Pickands 1975, Annals of Statistics 3:119; for few surrogates Knijnenburg and others 2009, Bioinformatics
25:i161). Of n gains let u be the (k + 1)-th greatest and s the mean excess over u of the k above it. A further gain
exceeds u with probability (k + 1) / (n + 1), since all orders are alike probable, and its excess x over u has

    P(excess > x) = (1 + x / (k s))^-k,

which is an exponential distribution whose scale is known by k excesses only (the ratio to their mean has an F
distribution with 2 and 2 k degrees of freedom). So the level of probability a is

    u + k s (((k + 1) / ((n + 1) a))^(1/k) - 1).
"""

import numpy as np

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.settings import SELECTION


def level(gains: Floats, probability: float = SELECTION.surrogate_level) -> float:
    """The gain [nat] that a further surrogate exceeds with a probability.

    gains (n,) [nat] : the greatest gain of each surrogate, in any order; n is 2 at least.
    """
    ordered = np.sort(gains)[::-1]
    n = len(ordered)
    k = max(1, round(SELECTION.surrogate_tail * n))
    edge = float(ordered[k])
    scale = float((ordered[:k] - edge).mean())
    beyond = (k + 1.0) / ((n + 1.0) * probability)
    return edge + k * scale * (max(1.0, beyond) ** (1.0 / k) - 1.0)
