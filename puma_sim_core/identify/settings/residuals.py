# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 10: free curves (`identify.residuals`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Residuals:
    """Thresholds of this stage."""

    # --- the bank of curves (`shape`)
    #: knots of a curve: over a physical axis, fine over the position, signed over time
    knots: int = 9
    fine_knots: int = 40
    signed_time_knots: int = 8
    time_knot: float = 0.5  #: time between knots of a curve over time [s]
    least_time_knots: int = 8  #: least of them
    most_time_knots: int = 60  #: most of them
    quantiles: tuple[float, float] = (0.002, 0.998)  #: quantiles of an axis between which its knots lie
    least_range: float = 1e-9  #: least range of an axis: of one that stands still there is no curve
    sign_noise: float = 2.0  #: speed of a change of sign, in standard deviations of the velocity's noise
    #: widths of the play operators of a hysteresis, over the range
    play_widths: tuple[float, ...] = (0.004, 0.01, 0.025, 0.06, 0.15)
    #: widths of one gap, over the range: least, as of the bank, greatest, which half of the range takes up, and number
    gap_widths: tuple[float, float, int] = (0.004, 0.5, 16)
    past: float = 0.025  #: past over which an acceleration is averaged [s]
    height: float = 0.5  #: standard deviation of the prior of a knot's height, in volts of the nominal friction scale
    step_distance: float = 0.25  #: distance of the places of a step in time [s]
    least_steps: int = 40  #: least number of them
    places_about: int = 20  #: places about the best of a step, or of a width
    line_density: float = 2.0  #: spectral lines per 1/(length of record)
    least_periods: float = 4.0  #: of the lowest over the record
    top_line: float = 0.95  #: highest, in terms of the second cutoff
    #: cycles of the motor a turn: least, greatest, step
    orders: tuple[float, float, float] = (0.5, 12.0, 0.25)
    least_order_rows: float = 0.1  #: least share of the rows where such a line lies below the second cutoff
    line_points: int = 33  #: points of a period of a line that is drawn
    normal_quantile: float = 1.96  #: 97.5 % quantile of the standard normal distribution, for the band of a curve

    # --- noise and choice of the curve
    clear: float = 10.0  #: least gain [nat] of a curve taken out before the noise
    most_curves: int = 6  #: that are tried for each joint
    occam_knot: float = 1.0  #: Occam factor of a knot [nat]
    nearly: float = 0.97  #: share of the best gain from which on a simpler curve goes before it [calibrated]
    much: float = 150.0  #: gain of a curve [nat] above which it may have stretched the parameters [calibrated]
    stretched: float = 4.0  #: standard deviations of its prior from which on a parameter counts as stretched
    rival_share: float = 0.2  #: of the best curve's gain, from which another joint's may be it [calibrated]

    # --- verdict (`verdict`, `outcome`)
    least_remainder: float = 20.0  #: gain [nat] of a remainder [calibrated]
    remainder_share: float = 0.003  #: of the first effect's gain, where the residual is near its floor [calibrated]
    #: open-loop error over what noise makes from which a log is not explained: between 4.9, the most of a right answer
    #: (a log of counts, test_excite; 2.2 on seeds 2300 to 2329), and 9.8, gravity_compensation's [calibrated]
    open_loop_beyond: float = 7.0
    #: longest correlation of a voltage that counts as noise there [s]: a tenth of a window, in which what is slower is
    #: all but a constant, which a model should have
    slowest_noise: float = 0.05
    #: the same over the steps of the two sensors of a transmission
    link_beyond: float = 10.0
    open_loop_share: float = 0.01  #: share of the nominal model's error below which nothing is left of it
    above_floor: float = 1.5  #: residual over its floor that no model discrepancy makes [calibrated]
    #: of a difference of two explanations, from which on it counts: 95 % of a normal distribution lie within
    standard_errors: float = 2.0
    ranked_curves: int = 8  #: curves that the ranking of axes has
    strained: float = 4.0  #: standard deviations from which a parameter is noted as far from its start
    listed: int = 4  #: most that are listed
    lags: float = 0.5  #: of the drawn autocorrelation [s]
    lag_block: float = 0.01  #: blocks that innovations are summed over before [s]
    least_lag_blocks: int = 20  #: least number of these


RESIDUALS = Residuals()
