# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 0: faults of the data (`identify.checks`)."""

from dataclasses import dataclass
from math import pi


@dataclass(frozen=True)
class Checks:
    """Thresholds of this stage."""

    channel_asked: float = 0.18  #: unexplained share of a voltage, below which nothing is asked
    channel_another: float = 0.45  #: above it, uncorrected, the log is of another plant
    channel_another_floor: float = 4.0  #: floor of voltages for both, in those of the nominal friction
    channel_shrinks: float = 0.4  #: share of itself that the residual must shrink to
    channel_left: float = 0.2  #: and share of the voltage that is enough
    channel_left_of: float = 0.1  #: the same, as a share of itself, where that is more
    channel_still_moves: float = 0.5  #: share of the most active joint's rows in which a corrected one moves
    channel_left_at_all: float = 0.4  #: residual of a joint's voltage, without a floor
    #: corrections this near in the sum of logarithms are alike: the simpler is named
    channel_alike: float = 0.4
    channel_alike_share: float = 0.04  #: shares below this are alike where voltages are scaled
    #: costs (`prior_fit`) that ask for scales near 1 and offsets; a correction's least gain, cost share and cost
    channel_far: float = 12.0
    channel_gain: float = 9.0
    channel_nearer: float = 0.5
    channel_near: float = 150.0
    channel_holds: float = 0.8  #: the share of the cost that may stay for the slow motion
    channel_moving_rows: float = 0.15  #: rows in which a joint that is judged by costs moves
    channel_moving: float = 2.0  #: its speed, in volts of the nominal friction
    channel_surer: float = 1.5  #: costs of offsets, which loads and tilt resemble, count so many times
    channel_rows: int = 300  #: rows that are enough for it
    #: scales that are beyond what parameters and effects can make, and offsets [rad] that are no encoder offsets
    channel_scales: tuple[float, ...] = (0.33, 0.4, 0.5, 0.57, 0.65, 0.7, 1.4, 1.5, 1.7, 2.0, 2.4, 3.0)
    channel_offsets: tuple[float, ...] = (0.15, 0.2, 0.3, 0.4, 0.55, 0.8, 1.1, pi / 2.0, pi)
    #: and those that only a voltage of which this share is not explained is asked for
    channel_far_scales: tuple[float, ...] = (0.2, 0.25, 4.0, 5.0)
    channel_far_asked: float = 0.3
    channel_great: float = 60.0  #: volts that can be millivolts or counts, over the nominal friction's
    channel_small: float = 1.0  #: and that can be kilovolts

    feedback_significance: float = 0.005  #: a p-value below this says that feedback biases [per joint]
    feedback_forgotten: float = 0.12  #: age past which noise is forgotten [s]
    feedback_ages: tuple[float, ...] = (0.0, 0.03, 0.08)  #: ages of the instruments behind it [s]

    gate_least_rows: int = 100  #: least rows of a log
    gate_least_time: float = 1.0  #: its least length [s]
    gate_rest_steps: float = 2.5  #: encoder steps by which a joint at rest moves at most
    gate_rest_share: float = 1e-5  #: or share of its range
    gate_rest_blocks: int = 50  #: blocks whose means count for it
    gate_rest_rows: float = 1e-3  #: and the share of the range for its rows
    gate_outside: float = 0.25  #: positions may be outside their ranges by this share of them
    gate_slow: float = 2.0  #: scales and offsets must hold for the motion below this frequency [Hz] alone

    plausibility_cutoff: float = 6.0  #: motion above this frequency [Hz] is not compared
    plausibility_rows: int = 1000  #: rows of the coarse series, at most about twice so many
    #: factors that honest records give to the parts of the model: (low, high)
    plausibility_emf: tuple[float, float] = (0.7, 1.4)
    plausibility_inertial: tuple[float, float] = (0.3, 2.5)
    plausibility_gravity: tuple[float, float] = (0.3, 4.0)
    #: and of drag, as a share of the speed's part, and of the weight of other links
    plausibility_drag: tuple[float, float] = (-0.2, 0.5)
    plausibility_others: tuple[float, float] = (-1.5, 1.5)
    plausibility_loaded: tuple[float, float] = (0.0, 0.5)  #: of friction that grows with the weight
    #: dry friction and offsets in volts of the nominal friction; width of the dry step, of the speed
    plausibility_dry: tuple[float, float] = (-0.5, 6.0)
    plausibility_offset: float = 3.0
    plausibility_dry_width: float = 0.02
    #: share of the range, or of a turn, that a joint without back-EMF coasts against friction where it counts as moving
    plausibility_carried: float = 0.01
    plausibility_slow: float = 0.1  #: speed of rest, in volts of the nominal friction
    plausibility_slow_share: float = 0.02  #: or share of the greatest speed
    plausibility_held: float = 7.0  #: friction that holds a joint at rest, in those volts
    plausibility_stops: tuple[float, ...] = (0.06, 0.2)  #: where a stop begins, as shares of the travel from its end
    #: voltages are compared with this many times those of the nominal friction, at least
    plausibility_floor: float = 2.0
    plausibility_noise: float = 0.04
    #: residual, in robust deviations, from which a row is out of line: 6e-5 of those of a normal distribution; the
    #: greatest share of rows that such an event takes, and how often they are sought
    plausibility_event: float = 4.0
    plausibility_event_share: float = 0.1
    plausibility_event_rounds: int = 8
    plausibility_enabled: float = 0.99  #: filtered `enable` above which a drive counts as on

    prior_fit_noise: float = 0.05  #: residual that counts, in volts of the nominal friction
    prior_fit_share: float = 0.007  #: and share of the joint's own
    prior_fit_correlated: float = 0.4  #: time of one independent value [s]
    #: widths; offset, dry friction and spring in volts of the nominal friction, drag in the speed's volts
    prior_fit_offset: float = 1.5
    prior_fit_dry: float = 2.0
    prior_fit_spring: float = 1.5
    prior_fit_loaded: float = 0.15  #: friction of loads
    prior_fit_drag: float = 0.08
    prior_fit_load: float = 3.0  #: [kg], at the lever
    prior_fit_lever: float = 0.4  #: [m]
    prior_fit_aside: float = 0.1  #: its centre from the line of the lever: half of an object that a hand holds [m]
    prior_fit_tilt: float = 0.07  #: [rad]
    prior_fit_lag: float = 8e-3  #: delay or lag of a sensor [s]
    prior_fit_dry_widths: tuple[float, ...] = (0.015, 0.08)  #: widths of the dry step, over the greatest speed

    row_even_share: float = 0.05  #: share of the steps of an even clock that may be off
    row_even: float = 0.02  #: by more than this share of the middle one
    row_missing: float = 1.5  #: a row is missing or late where a step is that many middle ones
    #: a gap over the middle step of an even clock, and of an uneven one. One row may be missing: two steps show what is
    #: below 0.25 of the rate of the rows, and the second cutoff is at most 0.126 of it
    row_gap_even: float = 2.5
    row_gap_uneven: float = 3.0
    row_gap_tail: float = 2.5  #: and over the step that 99 % stay below
    row_slowest: float = 0.2  #: the longest middle step [s] that shows a joint's motion
    row_impact: float = 20.0  #: an impact, in nominal friction torques
    row_margin: float = 1.5  #: factor on the acceleration that the torques can give a joint
    row_around: int = 5  #: rows of the slopes before and after a row
    row_spike: int = 25  #: rows of the longest spike
    row_fastest: float = 3.0  #: what a position may do in a row: over the speed of its voltage
    row_noise: float = 10.0  #: over its noise
    row_quanta: float = 4.0  #: over the encoder's step
    row_onward: float = 0.3  #: share of the slope within which joints that jump along their way agree
    row_many: float = 0.03  #: share of the rows out of line that are no single faults
    row_many_rows: int = 20  #: and least number of these
    row_back: float = 0.3  #: share of its height that a spike comes back to
    row_frozen_rows: int = 4  #: frozen rows of equal values before a jump
    row_jitter_rows: int = 30  #: least rows that show stamps that jitter
    #: a voltage's spike: over its bend, the nominal friction's volts, visible noise; over the others, no response
    row_volts: float = 4.0
    row_volts_unit: float = 5.0
    row_visible: float = 4.0
    row_volts_beyond: float = 3.0
    row_many_spikes: float = 0.005  #: greatest share of a voltage's spikes
    row_felt_time: float = 0.012  #: time in which a joint responds [s]
    row_felt: float = 0.4  #: least share of the expected response
    row_stuck: float = 2.2  #: volts of a joint at rest over those of its dry friction
    row_beside: float = 3.0  #: and beside these, in those of the nominal one
    row_stuck_unknown: float = 7.0  #: at most, or where it never moved
    row_at_an_end: float = 5.0  #: and over that, outward at an end of its travel
    row_end: float = 0.02  #: share of the travel that is its end
    row_explained: float = 0.4  #: share of a voltage that may be unexplained where a run of positions is called frozen
    row_frozen_travel: float = 0.02  #: a frozen channel is one whose joint would have moved by this share of its range
    row_frozen_quanta: float = 20.0  #: or by so many encoder steps
    row_frozen_whole: float = 0.98  #: share of the rows from which the whole channel is frozen
    row_frozen_time: float = 0.15  #: shortest frozen run of equal positions [s]
    row_frozen_volts: float = 0.25  #: and of equal voltages [s]
    row_steps: float = 0.6  #: share of a voltage in such runs, from which it is made of steps
    row_limit: float = 0.97  #: share of its greatest at which it is at its limit
    row_beside_motion: float = 8.0  #: a frozen one over the residual, beside the motion's

    #: a start that no input explains (`start_up`): windows [s] and their least rows, the longest start [s], which the
    #: authors of the rotary pendulum leave out, what must follow it [s], and its mean square over the worst later one:
    #: 14 and 37 where a hand held that pendulum (development logs); docs/method.md has synthetic ones
    start_window: float = 0.05
    start_window_rows: float = 3.0
    start_longest: float = 1.0
    start_beside: float = 2.0
    start_excess: float = 3.0
    start_elsewhere: float = 0.05  #: share of its rows whose position or voltage is not met again

    #: a motion that no drive made (`undriven`). What the input has beyond what the position gives is less than this
    #: share of it: 0.003 where a hand moved a pendulum, 0.25 and more in the development logs of other machines and in
    #: the committed records
    undriven_own: float = 0.02
    #: and less than this share of the torque that the accelerations need beyond what position and velocity give. With
    #: a plausible inertia (`plausibility_inertial`) it is 0.3 at least; 0.016 there, 0.18 and more in the others
    undriven_share: float = 0.1
    #: and that torque is more than this share of all that the accelerations need: 0.999 there
    undriven_left: float = 0.5

    zero_clearer: float = 20.0  #: what its gain must exceed that of every effect that may be named by [nat]


CHECKS = Checks()
