# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stages 5 and 7: which effects are named, validation (`identify.selection`)."""

from dataclasses import dataclass
from math import log, sqrt


@dataclass(frozen=True)
class Selection:
    """Thresholds of this stage."""

    # --- what a name needs
    #: of a name [nat]: of 450 synthetic records with nothing missing none had 13 to 20 nat (commit 7bc1047)
    least_gain: float = 16.0
    #: standard errors from the model without it, in the one direction in which they differ: those of 16 nat in a true
    #: model, whose gain is half the square of its standard error
    name_errors: float = sqrt(8.0)
    #: odds that a joint has dry friction: all nine driven joints of the development machines do (Laplace's rule of
    #: succession)
    dry_odds: float = 10.0
    #: of the only dry friction of a joint: the odds of 97.7 %, two standard errors, over `dry_odds`. 4.3 to 1 are asked
    #: of the log: 81 % of a normal distribution lie below 0.88
    dry_errors: float = 0.88
    #: gain [nat] that this friction needs beside what chance gives: 20 to 1, from which evidence is strong (Kass and
    #: Raftery 1995, J. Am. Stat. Assoc. 90:773). 1.55 nat, those of 0.88 standard errors, were an alarm of 1.7 nat in
    #: one of 11 synthetic records with nothing missing (seeds 2700 to 2711)
    least_dry: float = log(20.0)
    least_untried: float = 25.0  #: of a name [nat] without action on the validation set [calibrated]
    #: least gain [nat] of a name that gives a joint two masses, since no placebo goes through the model: of 510 names
    #: of synthetic records wrong ones of these had 17 to 35 nat, right ones 165 and more but for one (23b9b58)
    least_two_mass: float = 40.0
    most_effects: int = 6  #: most effects that are named: two of each of three joints
    placebos: int = 24  #: surrogates of a log, of curves and of the link's side too
    #: probability with which a surrogate may exceed what a gain must: 2 % of alarms that may be raised where nothing is
    #: missing, one half for a name and one for a remainder (`surrogates.level`)
    surrogate_level: float = 0.01
    #: share of the surrogates that the tail is fitted to: of maxima of 1 to 300 gains with 1 to 8 degrees of freedom
    #: 0.4 to 1.2 % then exceed the level of 1 % (simulated; test_loop_surrogates)
    surrogate_tail: float = 1.0 / 3.0
    #: of the log [s], which a push is compared with: one and a half widths of the longest
    elsewhere_piece: float = 0.75
    #: of the probability, with which a piece must be above the level of those without it to be left out: of simulated
    #: logs without a push 0.1 to 1.1 % are then above the level of 0.5 % (8000 each of 6 to 75 pieces)
    elsewhere_left_out: float = 0.2
    placebo_shifts: tuple[float, float] = (0.06, 0.94)  #: as shares of the record: far from no shift at all
    replacement_share: float = 0.4  #: of the best gain, where the best fails on the validation set [calibrated]

    #: gain [nat] of the best trial of a stage that accepted none, from which on a stage is made beside it: two standard
    #: errors of a true model. Of a pair none need be asked for alone
    worth_pairing: float = 8.0

    # --- effects that contain one another
    replacement_gain: float = 3.0  #: gain [nat] that an effect must be better by than one that it replaces [calibrated]
    exact: float = 1e-4  #: share of a gain to which fits are exact at best: it counts in a log without noise
    rivals: int = 3  #: the best trials with the gain of a name that are tried in the place of an effect
    unfinished: float = 3.0  #: difference [nat] of two fits from that of their trials: unfinished fits

    # --- trials that are fitted again
    #: best screened trials, and share of the best gain, whose derivatives are taken anew after a poor fit; the share is
    #: also that from which those that gain less than the screening saw start from the nominal parameters
    relinearised: int = 4
    relinearised_two_mass: int = 1
    relinearised_share: float = 0.03
    #: of the size of an effect that it contains, from which a trial starts once more
    size_shares: tuple[float, ...] = (1.0, 0.5, 0.25)
    #: times that trials start from those that contain them, or that they contain: there and back, and once more. Fits
    #: of a few steps each may creep on by 2 nat and more: of r01 of the other generator for minutes
    related_rounds: int = 3
    no_more: float = 1.0  #: gain of likelihood [nat] below which a trial is no more than an effect that it contains
    #: share of the best gain above which a trial is fitted to its end, for how many, and from which gain [nat] on
    near_best: float = 0.6
    most_polished: int = 4
    worth_polishing: float = 8.0
    #: derivatives taken for it at most, rounds with each, and gain [nat] that is enough
    polishings: int = 3
    polishing_rounds: int = 3
    polished: float = 2.0
    #: growth of the validation V^2 by a new noise that decides nothing, as a share [calibrated]; a greater one refuses
    #: the noise beyond this quantile of Student's t, by pieces [s] twice as long as the longest source of noise lasts
    worse_noise: float = 0.03
    noise_confidence: float = 0.975
    noise_piece: float = 0.33

    # --- cross-validation (`cross_validation`, `validate`)
    #: of a parameter outside a fold; below, it cannot be fitted without it
    least_information: float = 0.3
    fold_rounds: int = 2  #: rounds of each fit without a fold
    #: a difference over its standard error from which on it counts: 95 % of a normal distribution lie within
    standard_errors: float = 2.0
    window: float = 0.5  #: length of an open-loop window [s]
    shortest_window: float = 0.3  #: shortest one that counts [s]
    window_distance: float = 0.125  #: to the next [s]: no row of a fold of 0.8 s lies between two windows
    window_rows: int = 4  #: least rows of a window
    not_finite: float = 1e3  #: what an error of position is set to where the state does not stay finite [rad or m]


SELECTION = Selection()
