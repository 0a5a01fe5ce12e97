# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stages 2 and 4: residual, evidence, short list (`identify.screening`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Screening:
    """Thresholds of this stage."""

    causal_block: float = 6e-3  #: length of a block [s]
    search_whiteners: int = 1  #: whiteners of each joint that are kept: the last noise is asked for again
    #: share of what a voltage does to its own joint below which what it does to another is left out: 4 % of the squares
    coupling: float = 0.2
    causal_together: int = 64  #: columns that are multiplied with those of the parameters at once
    causal_precision: float = 1e-4  #: prior precision of the parameters of effects that are in the model

    evidence_near_best: float = 6.0  #: gain [nat] below the best candidate's that a legal one may have in its place

    known_held: float = 0.98  #: share of its limit from which a current counts as held by it

    residual_rest_noise: float = 4.0  #: speed of rest, in standard deviations of its noise
    residual_rest_share: float = 2e-3  #: or share of the greatest speed
    residual_rest_time: float = 0.12  #: least time of rest [s]
    residual_validation_share: float = 0.25  #: share of the record in the validation set
    residual_validation_block: float = 0.8  #: length of a block of it [s]
    residual_places: tuple[float, ...] = (0.5, 0.2, 0.8, 0.35, 0.65)  #: where in its period a block lies
    residual_unlike: float = 2.0  #: power there over that of other rows, from which it moves
    residual_peak: float = 0.5  #: share of a ratio of squared peaks that counts as one of powers
    residual_guard: float = 2.0  #: rows about a validation block in no set, in second filter's time constants

    search_retunings: int = 3  #: most linearisations of a retuning
    search_stays: float = 0.05  #: change of parameters, in deviations, that ends it
    search_rounds: int = 4  #: most changes of the best explanation, whose noise all are scored in

    short_list_slow: int = 8  #: slow hypotheses of a short list
    short_list_fast: int = 4  #: fast ones beside these
    short_list_least_screened: float = 0.0  #: their least gain in the screening [nat]: more likely with than without
    #: share of the best screened gain from which containing effects are tried, too, and those of two masses
    short_list_family: float = 0.3
    short_list_noisy: float = 2.0  #: noise of a far noisier joint, over the median
    short_list_unseen_occam: float = 4.0  #: Occam factor [nat] of what is tried there without evidence


SCREENING = Screening()
