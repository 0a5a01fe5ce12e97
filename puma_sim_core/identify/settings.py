# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Every threshold of the identification, stage by stage, each with its source.

A source is a derivation, a citation, or the calibration set that the value was chosen on ("calibrated on seeds X to
Y"). No threshold is moved on a log whose result is then reported.

"Calibrated on synthetic records" means: set on scores of records of the generator in test/blind, seeds 2000 to 2999 and
900000 to 906339, none of which any reported figure comes from (README); nothing more exact is on record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True)
class Data:
    """Stage 1: reading and sampling of logs (`identify.data`).

    Where a comment names no source, the value was chosen by hand or on synthetic development records; more is not on
    record.
    """

    # --- `filters`
    #: half of the exponent of the response
    filter_order: int = 8
    #: time constants 1/fc that the response takes to die away
    filter_settling: float = 2.5

    # --- `ingest`
    #: rows of a log that are read: a minute at 1 kHz. Explaining them takes 3.7 GB (an arm)
    reading_greatest_rows: int = 60_000

    # --- `sampling`
    #: first filter [Hz], and its greatest share of the sampling frequency
    sampling_first_cutoff: float = 60.0
    sampling_first_share: float = 0.30
    #: second filter [Hz], and its greatest share of the first
    sampling_second_cutoff: float = 25.0
    sampling_second_share: float = 0.42
    #: rows kept after the second filter, in multiples of its cutoff
    sampling_kept: float = 2.6
    #: steps of time that differ by less than this share count as even
    sampling_even: float = 0.02


@dataclass(frozen=True)
class Checks:
    """Stage 0: faults of the data (`identify.checks`).

    Where a comment names no source, the value was chosen by hand or on synthetic development records; more is not on
    record.
    """

    # --- `channel_faults`
    #: share of a voltage that is left over: below this nothing is asked; above that, with no way to put it
    #: right, the log is of another plant
    channel_asked: float = 0.18
    channel_another: float = 0.45
    #: floor of voltages for both, in those of a middling friction
    channel_another_floor: float = 4.0
    #: what is left over must shrink to this share of what it was, and to this share of the voltage
    channel_shrinks: float = 0.4
    channel_left: float = 0.2
    #: a joint that is put right moves in this share of the rows, at least, of that which moves most; what is
    #: left over of a joint's voltage itself, without a floor
    channel_still_moves: float = 0.5
    channel_left_at_all: float = 0.4
    #: ways within this difference of the sum of logarithms are alike: the simpler one is said
    channel_alike: float = 0.4
    #: shares below this are alike where voltages are scaled
    channel_alike_share: float = 0.04
    #: costs (see `prior_fit`): from which on a log is asked for scales near 1 and offsets; what a way must
    #: gain, the share of the cost that may stay, and the cost itself
    channel_far: float = 12.0
    channel_gain: float = 9.0
    channel_nearer: float = 0.5
    channel_near: float = 150.0
    #: the share of the cost that may stay for the slow motion
    channel_holds: float = 0.8
    #: a joint that is judged by them moves in this share of the rows, with speeds that take so many times the
    #: volts of a middling friction
    channel_moving_rows: float = 0.15
    channel_moving: float = 2.0
    #: costs of offsets, which loads and tilt resemble, count so many times
    channel_surer: float = 1.5
    #: rows that are enough for it
    channel_rows: int = 300
    #: scales that are beyond what parameters and effects can make, and offsets [rad] that are no encoder
    #: offsets
    channel_scales: tuple[float, ...] = (0.33, 0.4, 0.5, 0.57, 0.65, 0.7, 1.4, 1.5, 1.7, 2.0, 2.4, 3.0)
    #: and those that only a voltage of which this share is left over is asked for
    channel_far_scales: tuple[float, ...] = (0.2, 0.25, 4.0, 5.0)
    channel_far_asked: float = 0.3
    #: voltages that can be millivolts or counts, and kilovolts, in those of a middling friction
    channel_great: float = 60.0
    channel_small: float = 1.0

    # --- `feedback`
    #: a p-value below this says that feedback biases [per joint]
    feedback_significance: float = 0.005
    #: age [s] past which noise is forgotten, and the ages of the instruments behind it
    feedback_forgotten: float = 0.12
    feedback_ages: tuple[float, ...] = (0.0, 0.03, 0.08)

    # --- `gate`
    #: a log must have this many rows and last this long [s]
    gate_least_rows: int = 100
    gate_least_time: float = 1.0
    #: a joint that moves by less than so many encoder steps, or this share of its range, rests
    gate_rest_steps: float = 2.5
    gate_rest_share: float = 1e-5
    #: positions may be outside their ranges by this share of them
    gate_outside: float = 0.25
    #: scales and offsets must hold for the motion below this frequency [Hz] alone
    gate_slow: float = 2.0

    # --- `plausibility`
    #: motion above this frequency [Hz] plays no part here
    plausibility_cutoff: float = 6.0
    #: rows of the coarse series, at most about twice so many
    plausibility_rows: int = 1000
    #: factors that honest records give to the parts of the model: (low, high)
    plausibility_emf: tuple[float, ...] = (0.7, 1.4)
    plausibility_inertial: tuple[float, ...] = (0.3, 2.5)
    plausibility_gravity: tuple[float, ...] = (0.3, 4.0)
    #: and of drag, as a share of the speed's part, and of the weight of other links
    plausibility_drag: tuple[float, ...] = (-0.2, 0.5)
    plausibility_others: tuple[float, ...] = (-1.5, 1.5)
    #: dry friction and offsets in volts of a middling friction; width of the dry step, of the speed
    plausibility_dry: tuple[float, ...] = (-0.5, 6.0)
    plausibility_offset: float = 3.0
    plausibility_dry_width: float = 0.02
    #: a joint rests where its speed takes less than this share of the volts of a middling friction, or is below
    #: this share of its greatest speed; friction then holds it against so many times those
    plausibility_slow: float = 0.1
    plausibility_slow_share: float = 0.02
    plausibility_held: float = 7.0
    #: a stop begins at these shares of the way from an end of the travel
    plausibility_stops: tuple[float, ...] = (0.06, 0.2)
    #: voltages are compared with this many times those of a middling friction, at least
    plausibility_floor: float = 2.0
    plausibility_noise: float = 0.04

    # --- `prior_fit`
    #: what is left over counts in this share of the volts of a middling friction, with this share of the
    #: joint's own, and each so long [s] as one independent value
    prior_fit_noise: float = 0.05
    prior_fit_share: float = 0.007
    prior_fit_correlated: float = 0.4
    #: widths: offset, dry friction and spring in volts of a middling friction, load friction, drag as a share
    #: of the speed's volts, load [kg] at a lever [m], tilt [rad], delay or lag of a sensor [s]
    prior_fit_offset: float = 1.5
    prior_fit_dry: float = 2.0
    prior_fit_spring: float = 1.5
    prior_fit_loaded: float = 0.15
    prior_fit_drag: float = 0.08
    prior_fit_load: float = 3.0
    prior_fit_lever: float = 0.4
    prior_fit_tilt: float = 0.07
    prior_fit_lag: float = 8e-3
    #: widths of the step of dry friction, as shares of the greatest speed
    prior_fit_dry_widths: tuple[float, ...] = (0.015, 0.08)

    # --- `row_faults`
    #: a clock is even where all but this share of its steps are within this share of the middle one
    row_even_share: float = 0.05
    row_even: float = 0.02
    #: a gap: steps above so many middle ones with an even clock, and otherwise; and above so many times the
    #: step that all but 1 % stay below
    row_gap_even: float = 1.5
    row_gap_uneven: float = 3.0
    row_gap_tail: float = 2.5
    #: the longest middle step [s] that shows a joint's motion
    row_slowest: float = 0.2
    #: a blow, in middling friction torques; a margin
    row_blow: float = 20.0
    row_margin: float = 1.5
    #: rows of the slopes before and after a row; the longest spike
    row_around: int = 5
    row_spike: int = 25
    #: more rows than this share out of line are no single faults
    row_many: float = 0.03
    #: a joint that is held may have so many times the volts of its dry friction and, beside them, so many of a
    #: middling one; at most, or where it never moved, so many of those
    row_stuck: float = 2.2
    row_beside: float = 3.0
    row_stuck_unknown: float = 7.0
    #: and so many times that at an end of its travel, outward
    row_at_an_end: float = 5.0
    #: share of a voltage that may be left over where a stretch of the position is called frozen
    row_explained: float = 0.4
    #: a frozen channel is one whose joint would have moved by this share of its range
    row_frozen_travel: float = 0.02

    # --- `wrong_zero`
    #: what its gain must exceed that of every effect that may be named by [nat]
    zero_clearer: float = 20.0


@dataclass(frozen=True)
class Noise:
    """Stage 3: noise of residuals and innovations (`identify.noise`).

    Where a comment names no source, the value was chosen by hand or on synthetic development records; more is not on
    record.
    """

    # --- `noise`
    #: correlation times of disturbances [s]
    residual_lasting: tuple[float, ...] = (0.010, 0.040, 0.160)
    #: least standard deviation of the white voltage noise [V] in the band
    residual_least: float = 1e-4
    #: width of a band of the periodogram [Hz], and its least number of frequencies
    residual_band: float = 1.5
    residual_least_lines: int = 6
    #: share of the variance added to every diagonal: rows past the second filter are nearly dependent
    residual_jitter: float = 2e-3
    #: rows of one block of the covariance; longer stretches are cut
    residual_block: int = 1500

    # --- `colour`
    #: correlation times of disturbances [s]
    spectrum_lasting: tuple[float, ...] = (0.005, 0.010, 0.020, 0.040, 0.080, 0.160)
    #: width of a band: least [Hz], and as a share of its frequency; least number of lines in it
    spectrum_band: float = 1.0
    spectrum_share: float = 0.15
    spectrum_least_lines: int = 6
    #: shortest stretch of rows that gives a periodogram [s]
    spectrum_shortest: float = 0.3
    #: steps of a fit of weights
    spectrum_steps: int = 300
    #: longest filter [s]
    spectrum_longest: float = 1.5
    #: share of the lines of a tapered periodogram that are independent, and what a line that stands out counts
    #: as, over the spectrum
    spectrum_independent: float = 0.5
    spectrum_outlying: float = 8.0

    # --- `weighting`
    #: taps up to which a filter is run row by row
    whitening_direct: int = 64


@dataclass(frozen=True)
class Screening:
    """Stages 2 and 4: residual, evidence, short list (`identify.screening`).

    Where a comment names no source, the value was chosen by hand or on synthetic development records; more is not on
    record.
    """

    # --- `causal`
    #: length of a block [s]
    causal_block: float = 6e-3

    # --- `known_effects`
    #: share of its limit from which a current counts as held by it
    known_held: float = 0.98

    # --- `problem`
    #: a joint rests where its speed stays below this many standard deviations of its noise, or below this share
    #: of its greatest speed, for as long as this [s]
    residual_rest_noise: float = 4.0
    residual_rest_share: float = 2e-3
    residual_rest_time: float = 0.12
    #: share of the record that is kept back, and the length of a block of it [s]
    residual_held_share: float = 0.25
    residual_held_block: float = 0.8
    #: where in its period a block lies, the usual place first; power of the residual there, over that of the
    #: other rows, from which on another place is looked for
    residual_places: tuple[float, ...] = (0.5, 0.2, 0.8, 0.35, 0.65)
    residual_unlike: float = 2.0
    #: share of a ratio of squared peaks that counts as one of powers
    residual_peak: float = 0.5
    #: rows around a kept-back block that count for neither, in time constants of the second filter
    residual_guard: float = 2.0

    # --- `search`
    search_retunings: int = 3

    # --- `short_list`
    #: hypotheses of a short list, slow and fast, and their least gain in the screening
    short_list_slow: int = 8
    short_list_fast: int = 4
    short_list_least_screened: float = 2.0
    #: share of the best gain in the screening from which on the kinds that contain one are tried, too
    short_list_family: float = 0.3
    #: a joint is far noisier than the others from so many times the median of their noise on; the price [nat]
    #: of a coefficient of what is tried there unasked
    short_list_noisy: float = 2.0
    short_list_unseen_price: float = 4.0


@dataclass(frozen=True)
class Fitting:
    """Stage 6: hypotheses in the model, fitted to innovations (`identify.fitting`)."""

    # --- Kalman predictor (`predictor`)
    #: rows at the start of a log that smooth its first motion [s]: chosen by hand, not calibrated
    start_time: float = 0.03
    #: rows to each side of the start whose parabola gives its position: chosen by hand, not calibrated
    start_rows: int = 12
    #: time at the start of a log that the predictor is given to settle [s]: chosen by hand, not calibrated
    settling_time: float = 0.12
    #: greatest step of integration [s]: a row of 1 ms is one step; RK4 is stable up to 8.4 ms for the windings
    #: of the arm (3 ms), and its error at 1 ms is far below any sensor's noise
    greatest_step_time: float = 1.2e-3
    #: greatest step of integration in time constants of a winding: RK4 is stable up to 2.78 of them
    greatest_step_lags: float = 2.0
    #: least noise of a row's voltage that the gain is made for [V]: chosen by hand, not calibrated
    least_voltage_noise: float = 2e-3
    #: least noise of a row's voltage in residuals, in volts of the nominal friction scale: a log without noise must
    #: not make the last digits of a fit, or of an integration, into effects; chosen by hand, not calibrated
    least_row_noise: float = 2e-2
    #: least noise of a row's voltage, and greatest, that the predictor takes from the screening, in volts of the
    #: nominal friction scale: chosen by hand, not calibrated
    least_expected_noise: float = 0.02
    greatest_expected_noise: float = 0.5
    #: least noise of a position [rad or m], against division by zero
    least_position_noise: float = 1e-9
    #: least noise of a position, as a share of the standard deviation of its prediction: positions without noise would
    #: be followed so closely that the error of the start rings for a second; chosen by hand, not calibrated
    least_noise_of_prediction: float = 0.3
    #: variance a row added to position [rad2 or m2], velocity and current: keeps the Riccati equation regular
    regular_variance: tuple[float, float, float] = (1e-18, 1e-12, 1e-12)
    #: rows between those whose inertia the mean is taken of: chosen by hand, not calibrated
    inertia_every: int = 50
    #: models whose derivatives are cached: each is asked for again with other weightings, by the elimination of a
    #: stage and the start of the next, by the folds, and by the free curves
    cached_models: int = 3
    #: poses at which inertia is looked at, and the farthest of them on a joint without limits [rad or m]: chosen by
    #: hand, not calibrated
    poses: int = 64
    farthest_pose: float = 4.0
    #: least eigenvalue of the inertia matrix that is possible, as a share of that at the start: no machine moves with
    #: one that is not positive definite; chosen by hand, not calibrated
    least_inertia: float = 0.1
    #: frequencies of an integral over the spectrum: its error is far below that of the noise
    spectrum_points: int = 4097
    #: a response ends where it has fallen to this share of its greatest value, or after so many rows
    response_end: float = 1e-4
    response_rows: int = 4000
    #: standard deviation of a Gaussian over the median of its absolute value: 1 / Phi^-1(3/4)
    deviation_of_median: float = 1.4826
    #: least scale of row-to-row changes, as a share of their standard deviation: changes that are mostly zero, as of a
    #: coarse encoder, have a median of nothing; chosen by hand, not calibrated
    least_median_share: float = 0.3

    # --- Gauss and Newton (`prediction`)
    #: step of a finite difference, in standard deviations of a parameter of the mechanism and in sizes of a parameter
    #: of an effect: chosen by hand, not calibrated
    difference: float = 0.05
    effect_difference: float = 0.01
    #: prior precision of a parameter of an effect without a prior, per its size: so little that it decides nothing
    least_precision: float = 1e-4
    #: least value of a parameter with a logarithmic prior, over its median: keeps the logarithm finite
    prior_floor: float = 1e-3
    #: what a parameter of an effect near zero counts as, by its unit, and in any other unit; least size over it: chosen
    #: by hand, not calibrated
    typical_size: Mapping[str, float] = field(
        default_factory=lambda: MappingProxyType(
            {
                "rad": 0.02,
                "s": 1e-3,
                "V": 0.1,
                "N.m": 1.0,
                "1": 0.1,
                "A": 1.0,
                "kg": 0.3,
                "m": 0.1,
                "rad/s": 0.05,
                "N.m/rad": 5.0,
                "N.m.s/rad": 1.0,
                "1/A": 1e-3,
                "N.m.s2/rad2": 1.0,
            }
        )
    )
    typical_other: float = 0.1
    least_share_of_typical: float = 0.3
    #: greatest step of a parameter of an effect, in its sizes: chosen by hand, not calibrated
    greatest_step: float = 1.5
    #: shares of a step that are tried one after the other: chosen by hand, not calibrated
    step_shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)
    #: rounds of a fit, and the gain [nat] below which a round is the last: chosen by hand, not calibrated
    rounds: int = 4
    least_round_gain: float = 0.1
    #: rounds of a fit from the start values: chosen by hand, not calibrated
    rounds_from_start: int = 6
    #: gain [nat] of new derivatives below which a fit counts as finished, and most times that they are taken: a base
    #: that is not finished lends its gain to whatever is tried first; chosen by hand, not calibrated
    finished: float = 2.0
    relinearisations: int = 2
    #: the same of the final model: chosen by hand, not calibrated
    finished_final: float = 0.5
    relinearisations_final: int = 4

    # --- Occam factors (`occam`)
    #: least and greatest Occam factor [nat] of a coefficient by the screening, which is no measure where the fit goes
    #: far from what was screened: calibrated on synthetic records (see the module's docstring)
    least_occam: float = 1.5
    greatest_occam: float = 6.0
    #: prior precision of a parameter, per its size, where its prior over coordinates counts instead: as good as none
    no_precision: float = 1e-8
    #: step of a difference of coordinates, as a share of the size of a parameter: chosen by hand, not calibrated
    coordinate_difference: float = 1e-4
    #: least ratio of variances of posterior and prior: keeps the logarithm finite
    least_variance_ratio: float = 1e-12

    # --- trials (`trials`)
    #: a tie: gains closer than this [nat], or than this share of the better one; calibrated on synthetic records (see
    #: the module's docstring)
    tie: float = 8.0
    tie_share: float = 0.003
    #: share of its screened gain that a fit must reach, else all derivatives are taken anew: calibrated on synthetic
    #: records (see the module's docstring)
    promised: float = 0.7
    #: rounds of a trial's fit, of one with derivatives of its own, and of such a two-mass model: chosen by hand, not
    #: calibrated
    trial_rounds: int = 5
    relinearised_rounds: int = 3
    two_mass_rounds: int = 6
    #: share of screened coefficients that slopes are taken over: chosen by hand, not calibrated
    small_coefficients: float = 1e-3
    #: shares of a screened threshold that a fit may start from: chosen by hand, not calibrated
    threshold_starts: tuple[float, ...] = (0.7, 0.8, 0.87, 0.94, 1.0, 1.07, 1.15, 1.3)
    #: change [nat] of the log likelihood on the validation set, and share of the gain, below which an effect does not
    #: act there: calibrated on synthetic records (see the module's docstring)
    untried: float = 1.5
    untried_share: float = 0.03
    #: how far above its greatest plausible size a parameter may come out, and how far below the least: calibrated on
    #: synthetic records (see the module's docstring)
    above_plausible: float = 2.0
    below_plausible: float = 4.0

    # --- confidence intervals (`intervals`)
    #: 97.5 % quantile of the standard normal distribution
    normal_quantile: float = 1.959963984540054
    #: longest lag over which scores are correlated [s], and the blocks that they are summed over before [s]: chosen by
    #: hand, coverage measured on synthetic records (README)
    longest_lag: float = 0.33
    score_block: float = 0.02
    #: where a profile is looked at, over the reach of the sandwich, which is the least that counts: chosen by hand, not
    #: calibrated
    profile_shares: tuple[float, ...] = (1.0, 1.5, 2.5, 4.0)
    #: rounds of a fit of a profile: chosen by hand, not calibrated
    profile_rounds: int = 3
    #: greatest fall of the log likelihood that interpolation of a profile reckons with, over the one looked for
    greatest_fall: float = 1e6


@dataclass(frozen=True)
class Selection:
    """Stages 5 and 7: which effects are named, validation (`identify.selection`)."""

    # --- what a name needs
    #: least gain [nat] of a name, whatever the placebos say: of 450 synthetic records with nothing missing none had a
    #: gain of 13 to 20 nat but what other limits refuse (commit 7bc1047)
    least_gain: float = 16.0
    #: share of the first effect's gain that a further one must reach: smaller gains are attributed to model discrepancy
    #: of the first effect; calibrated on synthetic records (see the module's docstring)
    least_share: float = 0.015
    #: least gain [nat] of a name that does not act on the validation set, and least share of the first effect's gain if
    #: it is a further one: calibrated on synthetic records (see the module's docstring)
    least_untried: float = 25.0
    untried_share: float = 0.03
    #: least gain [nat] of a name that gives a joint two masses, since no placebo goes through the model: of 510 names
    #: of synthetic records the wrong ones of these had 17 to 35 nat, the right ones 165 and more but for one of size
    #: 0.55 (commit 23b9b58)
    least_two_mass: float = 40.0
    #: most effects that are named: chosen by hand, not calibrated
    most_effects: int = 4
    #: placebos, and what a gain must exceed their greatest by: a factor and an addend [nat]; calibrated on synthetic
    #: records (see the module's docstring)
    placebos: int = 24
    placebo_factor: float = 1.2
    placebo_margin: float = 2.0
    #: least and greatest shift of a placebo, as a share of the record: far from no shift at all
    placebo_shifts: tuple[float, float] = (0.06, 0.94)
    #: least share of the first effect's gain that counts at a joint, since model discrepancy shows at other joints too:
    #: calibrated on synthetic records (see the module's docstring)
    elsewhere: float = 0.2
    #: least share of the best gain of what is named in place of the best, where that fails on the validation set:
    #: calibrated on synthetic records (see the module's docstring)
    replacement_share: float = 0.4

    # --- effects that contain one another
    #: gain [nat] that an effect must be better by than one that it contains, the difference of their Occam factors
    #: included: calibrated on synthetic records (see the module's docstring)
    parsimony: float = 1.5
    #: gain [nat] that an effect must be better by than one that it replaces: calibrated on synthetic records (see the
    #: module's docstring)
    replacement_gain: float = 3.0
    #: share of a gain to which fits are exact at best: it counts in a log without noise; chosen by hand, not calibrated
    exact: float = 1e-4
    #: share of its gain from which on a rival is tried in the place of an effect, and how many: chosen by hand, not
    #: calibrated
    rival_share: float = 0.5
    rivals: int = 3
    #: difference [nat] between what two trials promised and what their fits come to, from which on they count as
    #: unfinished: chosen by hand, not calibrated
    unfinished: float = 3.0

    # --- trials that are fitted again
    #: for how many of the best in the screening, and from which share of the best gain there on, all derivatives are
    #: taken anew where a fit does not keep what was promised: chosen by hand, not calibrated
    relinearised: int = 4
    relinearised_two_mass: int = 1
    relinearised_share: float = 0.03
    #: gain of likelihood [nat] below which a trial is no more than an effect that it contains: chosen by hand, not
    #: calibrated
    no_more: float = 1.0
    #: share of the best gain above which a trial is fitted to its end, for how many, and from which gain [nat] on:
    #: chosen by hand, not calibrated
    near_best: float = 0.6
    most_polished: int = 4
    worth_polishing: float = 8.0
    #: most times that derivatives are taken for it, rounds of the fit with each, and the gain [nat] below which that is
    #: enough: chosen by hand, not calibrated
    polishings: int = 3
    polishing_rounds: int = 3
    polished: float = 2.0
    #: ratio of squared voltages on the validation set, mean of the joints, of the model in the noise before over that
    #: in the noise after the trials, below which the noise before is preferred: calibrated on synthetic records (see
    #: the module's docstring)
    better_noise: float = 0.97

    # --- cross-validation (`cross_validation`, `validate`)
    #: a parameter of an effect of which a fold leaves less than this share of the information to the others cannot be
    #: fitted without it: chosen by hand, not calibrated
    least_information: float = 0.3
    #: rounds of each fit without a fold: chosen by hand, not calibrated
    fold_rounds: int = 2
    #: length of an open-loop window [s], the shortest one that counts, and how far the next begins: at this distance no
    #: row of a fold of 0.8 s falls between two windows
    window: float = 0.5
    shortest_window: float = 0.3
    window_distance: float = 0.125
    #: least rows of a window: chosen by hand, not calibrated
    window_rows: int = 4
    #: what an error of position is set to where the state does not stay finite [rad or m]
    not_finite: float = 1e3


@dataclass(frozen=True)
class Residuals:
    """Stage 10: free curves (`identify.residuals`)."""

    # --- the bank of curves (`shape`)
    #: knots of a curve over a physical axis, of a fine one over the position, and of one over time with the sign of the
    #: velocity: chosen by hand, not calibrated
    knots: int = 9
    fine_knots: int = 40
    signed_time_knots: int = 8
    #: time between the knots of a curve over time [s], least and most of them: chosen by hand, not calibrated
    time_knot: float = 0.5
    least_time_knots: int = 8
    most_time_knots: int = 60
    #: quantiles of an axis between which its knots lie: chosen by hand, not calibrated
    quantiles: tuple[float, float] = (0.002, 0.998)
    #: least range of an axis: of one that stands still there is no curve
    least_range: float = 1e-9
    #: speed of a change of sign, in standard deviations of the velocity's noise: chosen by hand, not calibrated
    sign_noise: float = 2.0
    #: widths of the play operators of a hysteresis, as shares of the range: chosen by hand, not calibrated
    play_widths: tuple[float, ...] = (0.004, 0.01, 0.025, 0.06, 0.15)
    #: past over which an acceleration is averaged [s]: chosen by hand, not calibrated
    past: float = 0.025
    #: standard deviation of the prior of a knot's height, in volts of the nominal friction scale: chosen by hand, not
    #: calibrated
    height: float = 0.5
    #: distance of the places of a step in time [s], least number of them, and places between those about the best of
    #: these: chosen by hand, not calibrated
    step_distance: float = 0.25
    least_steps: int = 40
    steps_about: int = 20
    #: spectral lines per 1/(length of record), the least frequency in periods over the record, and the highest in terms
    #: of the second cutoff: chosen by hand, not calibrated
    line_density: float = 2.0
    least_periods: float = 4.0
    top_line: float = 0.95
    #: cycles of the motor a turn that are looked for: least, greatest, and their distance; chosen by hand, not
    #: calibrated
    orders: tuple[float, float, float] = (0.5, 12.0, 0.25)
    #: least share of the rows where such a line lies below the second cutoff: chosen by hand, not calibrated
    least_order_rows: float = 0.1
    #: points of a period of a line that is drawn
    line_points: int = 33
    #: 97.5 % quantile of the standard normal distribution, for the band of a curve
    normal_quantile: float = 1.96

    # --- noise and choice of the curve
    #: least gain [nat] of a curve that may be taken out before the noise is measured, how many are tried for each
    #: joint, and the Occam factor of a knot [nat]: chosen by hand, not calibrated
    clear: float = 10.0
    most_curves: int = 6
    occam_knot: float = 1.0
    #: share of the best gain from which on a simpler curve goes before it: calibrated on synthetic records (see the
    #: module's docstring)
    nearly: float = 0.97
    #: gain of a curve [nat] above which it may have stretched the parameters: calibrated on synthetic records (see the
    #: module's docstring)
    much: float = 150.0
    #: standard deviations of its prior from which on a parameter counts as stretched: chosen by hand, not calibrated
    stretched: float = 4.0
    #: share of the best curve's gain from which on another joint's may be the one that is missing: calibrated on
    #: synthetic records (see the module's docstring)
    rival_share: float = 0.2
    #: placebos of the curves, and least and greatest shift of one, as a share of the record: chosen by hand, not
    #: calibrated
    placebos: int = 24
    placebo_shifts: tuple[float, float] = (0.06, 0.94)

    # --- verdict (`verdict`, `outcome`)
    #: least gain [nat] of a remainder, and its least share of the gain of the first effect where the residual is near
    #: its floor: calibrated on synthetic records (see the module's docstring)
    least_remainder: float = 20.0
    remainder_share: float = 0.003
    #: a residual above so many times its floor is more than model discrepancy of what was named: calibrated on
    #: synthetic records (see the module's docstring)
    above_floor: float = 1.5
    #: what a remainder's gain must exceed the placebos' greatest by: a factor and an addend [nat]; calibrated on
    #: synthetic records (see the module's docstring)
    placebo_factor: float = 1.3
    placebo_margin: float = 3.0
    #: share of a joint's squared innovations after the names below which a free curve is preferred to them: where a
    #: remainder is left, as of measured logs, which neither explains to the end, and where none is; calibrated on
    #: synthetic records (see the module's docstring)
    clearly_less: float = 0.9
    less_than_all: float = 0.985
    #: curves that the ranking of axes has: chosen by hand, not calibrated
    ranked_curves: int = 8
    #: standard deviations of its prior from which on a parameter is said to be far from its start, and how many are
    #: listed: chosen by hand, not calibrated
    strained: float = 4.0
    listed: int = 4
    #: lags of the drawn autocorrelation [s], the blocks that innovations are summed over before [s], and the least
    #: number of these: chosen by hand, not calibrated
    lags: float = 0.5
    lag_block: float = 0.01
    least_lag_blocks: int = 20


@dataclass(frozen=True)
class Experiment:
    """Stage 11: the next experiment (`identify.experiment`).

    Where a comment names no source, the value was chosen by hand or on synthetic development records; more is not on
    record.
    """

    # --- `design`
    #: motions of a search, and of one whose columns take long
    design_motions: int = 150
    design_fewer_motions: int = 80
    #: what part of them is tried without the compiled kernel, which simulates ten times faster
    design_uncompiled: float = 0.2
    #: columns from which they take long
    design_many_columns: int = 40
    #: share of the motions that are random, and how many of the best are gone on from
    design_random: float = 0.4
    design_kept: int = 4
    #: motions that a look for exact ties takes; gain [nat] and share that are nothing in all of them
    design_looks: int = 10
    design_nothing: float = 0.5
    design_no_share: float = 1e-4
    #: how wrong parameters may be, viscous friction among them, and the machines that are tried
    design_wrong: float = 0.08
    design_viscous_wrong: float = 0.25
    design_machines: int = 4
    #: step in which machines are simulated where no more is asked than that they stay in their ranges
    design_coarse_step: float = 5e-3
    #: rows of a file, and the least rate that the filters of `explain` can use [1/s]
    design_most_rows: int = 300_000
    design_least_rate: float = 100.0
    design_shortest: float = 2.0
    design_longest: float = 600.0

    # --- `excitation`
    motion_harmonics: int = 5
    motion_fast: int = 3
    #: rest at the start and at the end of a record [s], and the time in which a motion swells
    motion_rest: float = 0.15
    motion_swell: float = 0.8
    #: frequencies of the Fourier series' base at the most, and of the fast waves [Hz]
    motion_base: float = 0.4
    motion_fast_band: tuple[float, float] = (4.0, 15.0)
    #: how sharp the corners of a triangle are: 1 is a corner
    motion_sharp: float = 0.97
    #: share of the range that is kept free at each end, share of the voltage that is used
    motion_margin: float = 0.06
    motion_voltage_share: float = 0.95
    #: supply of the arm's motors [V]; of other machines, in voltages of a middling friction torque
    motion_arm_voltage: float = 40.0
    motion_other_voltage: float = 10.0
    #: greatest speed where none is given, in ranges of the joint a second
    motion_speed: float = 0.6

    # --- `next_experiment`
    #: motions that are looked at before an effect counts as one that no motion shows, their length [s]
    offer_looks: int = 6
    offer_seconds: float = 5.0

    # --- `separation`
    #: noise of the voltage [V] within the second filter's band
    separation_noise: float = 0.05
    #: cutoffs of the filters [Hz], as in `sampling`
    separation_first: float = 60.0
    separation_second: float = 25.0
    #: step of columns [s]; a finer one for waves of the motor's angle, which would fold down to low
    #: frequencies, and for shifts in time. Parameters' derivatives, which are smooth, are taken at a coarse
    #: one; rows are kept at a coarser one yet
    separation_step: float = 5e-3
    separation_fine: float = 2.5e-3
    separation_coarse: float = 1e-2
    separation_kept: float = 2e-2
    #: counts of an encoder a turn of the motor; of one joint without gears, counts of its range
    separation_counts: float = 1000.0
    separation_counts_of_range: float = 16384.0
    #: rows of a block of a product
    separation_block: int = 64
    #: a joint rests below this many standard deviations of its speed's noise, for this long [s]
    separation_rest_noise: float = 4.0
    separation_rest_time: float = 0.12


DATA = Data()
CHECKS = Checks()
NOISE = Noise()
SCREENING = Screening()
FITTING = Fitting()
SELECTION = Selection()
RESIDUALS = Residuals()
EXPERIMENT = Experiment()
