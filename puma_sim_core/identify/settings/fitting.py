# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 6: hypotheses in the model, fitted to innovations (`identify.fitting`)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True)
class Fitting:
    """Thresholds of this stage."""

    # --- Kalman predictor (`predictor`)
    start_time: float = 0.03  #: rows at the start of a log that smooth its first motion [s]
    start_rows: int = 12  #: rows to each side of the start whose parabola gives its position
    settling_time: float = 0.25  #: time at the start of a log that the predictor is given to settle [s]
    greatest_step_time: float = 1.2e-3  #: greatest step [s]; RK4 is stable up to 8.4 ms for the arm's windings (3 ms)
    #: steps of two masses in a second [1/s] beyond which a model is not run: time constants of ten microseconds show in
    #: no log. 3e5 N.m/rad with 100 N.m.s/rad on a rotor of 0.0022 kg.m2 (dfki_pendulum) take 7e4
    greatest_rate: float = 1e5
    #: steps of two masses in a row that follow a vibration of a quarter of the log's rows a second, half of what rows
    #: can show, with the 0.4 rad a step of `plant.drive_train`; and the share of its steps for what is faster: up to
    #: 0.8 rad of a vibration, which RK4 damps by 0.17 %, and two time constants of a decay, of which it bears 2.78
    steps_of_shown: float = 4.0
    unseen_steps: float = 0.5
    #: steps [s] that are tried first, the greatest that the error of the innovations allows [standard deviations of
    #: those]: an error of RK4 grows with the fifth power of a rate, so a model three times as fast has about 2 %
    further_steps: tuple[float, ...] = (5e-3, 2.5e-3)
    step_error: float = 1e-4
    #: greatest step in time constants of a winding: RK4 is stable up to 2.78
    greatest_step_lags: float = 2.0
    #: and in rows in which a law switches its current: an instant within a step has an error of its square. On a
    #: current limit of 570 times the noise, in 1.4, 0.3 and 0.06 % of the innovations at 0.31, 0.16 and 0.08 of 3 ms;
    #: over 10000 rows that is 1.4, 0.3 and 0.06 standard deviations of a parameter (development record 2670)
    switched_step_lags: float = 0.12
    switched_halves: int = 3  #: of the step at most: a fit may make a winding as fast as it likes
    #: share of an error that the predictor has left after the settling time, and least noise of a row's voltage that
    #: its gain is made for, in volts of the nominal friction scale. A faster one follows impacts in place of the model;
    #: a slower one carries the error of the start, or of parameters, into later rows. The least noise is calibrated:
    #: backlash is found from 0.05 to 0.2 (records r05 to r07 of another generator), and with less of it innovations
    #: of the nominal model are far from white (seeds 2306 and 2323)
    forgotten: float = 0.0025
    least_gain_noise: float = 0.05
    least_memory_rows: float = 4.0  #: rows that this takes at least
    memory_range: float = 40.0  #: greatest change of the logarithm of the volts in the search of it
    memory_bisections: int = 30  #: bisections of that logarithm
    undone_to: float = 0.1  #: cutoff to which the predictor's response is undone, in the sampling frequency
    least_voltage_noise: float = 2e-3  #: least noise of a row's voltage that the gain is made for [V]
    least_row_noise: float = 2e-2  #: in residuals, in volts of the nominal friction scale: rounding is no effect
    #: least and greatest noise of a row's voltage from the screening, in volts of the nominal friction scale
    least_expected_noise: float = 0.02
    greatest_expected_noise: float = 0.5
    least_position_noise: float = 1e-9  #: least noise of a position [rad or m], against division by zero
    #: least noise of a position, as a share of the standard deviation of its prediction: positions without noise would
    #: be followed so closely that the error of the start rings for a second
    least_noise_of_prediction: float = 0.3
    #: added variance of position, velocity and current a row: keeps the Riccati equation regular
    regular_variance: tuple[float, float, float] = (1e-18, 1e-12, 1e-12)
    inertia_every: int = 50  #: rows between those whose inertia the mean is taken of
    cached_runs: int = 16  #: runs whose innovations are cached: derivatives begin where the fit has just been
    cached_models: int = 3  #: models with cached derivatives: elimination, next stage, folds and curves ask again
    poses: int = 64  #: poses at which inertia is looked at
    farthest_pose: float = 4.0  #: farthest of them on a joint without limits [rad or m]
    least_inertia: float = 0.1  #: eigenvalue of the inertia matrix over that at the start: it is positive definite
    spectrum_points: int = 4097  #: frequencies of an integral over the spectrum: error far below the noise's
    response_end: float = 1e-4  #: share of its greatest value at which a response ends
    response_rows: int = 4000  #: or rows
    deviation_of_median: float = 1.4826  #: of a Gaussian, over its median absolute value: 1 / Phi^-1(3/4)
    #: rows in motion that show a joint's noise at least: the median of so many is known to 12 %
    least_noisy_rows: int = 100
    least_median_share: float = 0.3  #: of the standard deviation of row-to-row changes: a coarse encoder's median is 0

    # --- Gauss and Newton (`prediction`)
    #: finite difference, in standard deviations of a mechanism's parameter: over 0.05 the innovations of a log may bend
    #: so much that a fit stays on a ridge, 6 nat from its end (`test_loop_ridges`)
    difference: float = 1e-3
    #: of both sides, in deviations and in sizes of an effect's parameter: its error is a millionth of what the third
    #: derivative makes of a deviation, and that of rounding, 1e-16 over it, is less
    central_difference: float = 1e-3
    whitened_together: int = 8  #: derivatives that are whitened at once: one group of vector registers
    effect_difference: float = 0.01  #: in sizes of an effect's parameter
    #: shares of the way from the start values to the retuned ones that are tried until the logs can be predicted
    runnable_shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.125)
    least_precision: float = 1e-4  #: of an effect's parameter without a prior, per its size: decides nothing
    prior_floor: float = 1e-3  #: of a logarithmic prior's parameter over its median: keeps the logarithm finite
    #: what a parameter of an effect near zero counts as, by its unit, and in any other unit; least size over it
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
    greatest_step: float = 1.5  #: greatest step of a parameter of an effect, in its sizes
    step_shares: tuple[float, ...] = (0.5, 0.25, 0.1)  #: shares of a step that are tried where a whole one is too long
    #: shares of the curvature that damp a step, with dry friction: powers of ten (Marquardt 1963, J. SIAM 11:431)
    dampings: tuple[float, ...] = (0.1, 1.0, 10.0, 100.0)
    rounds: int = 4  #: rounds of a fit
    least_round_gain: float = 0.1  #: gain [nat] below which a round is the last
    #: gain [nat] by the derivatives below which no step is tried: one of a 22nd of a standard error, sqrt(2 gain)
    least_promise: float = 1e-3
    rounds_from_start: int = 6  #: rounds of a fit from the start values
    #: gain [nat] of new derivatives that ends a fit, and how often: an unfinished base lends its gain to trials
    finished: float = 2.0
    relinearisations: int = 2
    #: share of the objective that one which is far from its end still falls by, and how often derivatives are taken of
    #: such a one: the slowest fit of a limit that then came to its end fell by a seventh once [record 994807]
    falling: float = 0.1
    relinearisations_far: int = 10
    finished_final: float = 0.5  #: the same of the final model
    relinearisations_final: int = 4  #: and how often

    # --- Occam factors (`occam`)
    #: Occam factor [nat] of a screened coefficient: screening is no measure far from its point [calibrated]
    least_occam: float = 1.5
    greatest_occam: float = 6.0
    #: per size, of a parameter whose prior over coordinates counts instead
    no_precision: float = 1e-8
    coordinate_difference: float = 1e-4  #: step of a difference of coordinates, as a share of the size of a parameter
    least_variance_ratio: float = 1e-12  #: least ratio of variances of posterior and prior: keeps the logarithm finite
    greatest_variance_ratio: float = 1e12  #: variance over the prior's from which a sum of both loses digits that count

    # --- trials (`trials`)
    #: a tie: gains closer than this [nat], two standard errors of a true model's, whose variance is twice the gain
    tie: float = 8.0
    tie_share: float = 0.003  #: or than this share of the better one [calibrated]
    promised: float = 0.7  #: of the screened gain; below it all derivatives are taken anew [calibrated]
    trial_rounds: int = 5  #: rounds of a trial's fit
    relinearised_rounds: int = 3  #: of one with derivatives of its own
    patient_rounds: int = 6  #: more of each in turn as long as the best is worse than without the effect
    two_mass_rounds: int = 6  #: of such a two-mass model
    small_coefficients: float = 1e-3  #: share of screened coefficients that slopes are taken over
    threshold_starts: tuple[float, ...] = (0.7, 0.8, 0.87, 0.94, 1.0, 1.07, 1.15, 1.3)  #: over the screened
    #: and over a machine's range, two decades or less: neighbours 1.3 apart, as in the widest of those steps
    threshold_sizes: int = 18
    untried: float = 1.5  #: change [nat] of the validation log likelihood of no action there [calibrated]
    untried_share: float = 0.03  #: and share of the gain [calibrated]
    above_plausible: float = 2.0  #: how far above its greatest plausible size a parameter may be [calibrated]
    below_plausible: float = 4.0  #: and below the least [calibrated]
    #: share of what a motion takes at root mean square that a limit leaves: the start parameters may be wrong by a
    #: factor of two
    limit_of_motion: float = 0.5
    at_bound: float = 1e-6  #: of a bound of a law, within which a fitted parameter stands on it

    # --- scatter of scores between blocks (`dispersion`)
    #: length of a block [s], that of the validation set: longer than any noise source lasts (0.16 s); least number of
    #: blocks that show a scatter, and standard errors of it that count as chance
    dispersion_block: float = 0.8
    dispersion_least_blocks: int = 4
    dispersion_errors: float = 2.0

    # --- confidence intervals (`intervals`)
    normal_quantile: float = 1.959963984540054  #: 97.5 % quantile of the standard normal distribution
    #: lag over which scores correlate, blocks [s]: by hand, coverage measured on synthetic records (README)
    longest_lag: float = 0.33
    score_block: float = 0.02
    #: points of a profile, over the sandwich's reach
    profile_shares: tuple[float, ...] = (0.3, 0.6, 1.0, 1.5, 2.5, 4.0, 7.0, 12.0, 20.0)
    #: and beyond where that ends, with new derivatives by all parameters
    farther_shares: tuple[float, ...] = (1.0, 1.5, 2.5, 4.0, 7.0, 12.0, 20.0)
    #: and over the way to the size at which an effect vanishes
    vanishing_shares: tuple[float, ...] = (0.25, 0.5, 0.75, 0.9, 1.0)
    profile_rounds: int = 3  #: rounds of a fit of a profile
    greatest_fall: float = 1e6  #: of the log likelihood in a profile's interpolation, over that wanted


FITTING = Fitting()
