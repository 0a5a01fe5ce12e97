# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Every number that decides in an appraisal, with its derivation or source."""

from typing import NamedTuple

#: time between setpoints [s], and rows of a response in it: those of the thesis's servo (section 7.6)
SETPOINT_PERIOD, ROWS = 0.028, 30
#: greatest voltage at the motors [V], that of the thesis's amplifiers
VOLTAGE_LIMIT = 40.0
#: what the wrist is to keep [m]: ten times the +-0.1 mm that the PUMA 560 is specified to repeat within
ACCURACY = 1e-3
#: time in which the arm comes to rest before a task begins [s]: thirty setpoints
REST = 0.84
#: time that a move may take beyond the least that speed and acceleration allow [s]: a loop of three poles at 20 rad/s,
#: half of what the servo rate allows `computed_torque`, is within 2 % of a step after 0.38 s; two setpoints more
SETTLING = 0.45
#: overshoot of a step [-]: that of a second-order loop with a damping ratio of 0.45, the least that is usually accepted
OVERSHOOT = 0.2
#: overshoot behind a saturated slew [-]: that of a damping ratio of 0.6; what is more is wound up
WOUND_UP = 0.1
#: how far a pushed arm may be away from its setpoint, in `ACCURACY` of the wrist at full reach
PUSHED = 5.0
#: setpoint periods that an arm may be behind a moving setpoint: that in which it comes, and one to answer it
LATE = 2.0
#: margins of the sampled loop: greatest sensitivity 2 (6 dB), which guarantees a gain margin of 2 and 29 degrees
#: (Astrom and Murray, Feedback Systems, section 10.5)
GREATEST_SENSITIVITY = 2.0


class Patience(NamedTuple):
    """Wall-clock times [s] that a controller of the user's gets. Far above what any working one needs, so that a busy
    machine fails nobody: they decide nothing but that a battery ends."""

    answer: float = 2.0  #: for one answer
    trial: float = 60.0  #: for all answers of a trial
    start: float = 60.0  #: to import and make it
    times: int = 3  #: late answers, or deaths, in a unit before its other trials fail untried


class Profile(NamedTuple):
    """How much a battery does."""

    draws: int  #: of each random perturbation
    tasks: tuple[str, ...]  #: that perturbations are tried on; () for all
    effect_tasks: tuple[str, ...]  #: that single effects are tried on
    critical_draws: int  #: arms on which a critical size is sought
    bisections: int  #: halvings of the logarithm of a size
    resamples: int  #: of a bootstrap
    bags: int | None  #: failed trials a controller that are recorded; None: all


#: a trial takes 2 to 40 ms with an arm without effects, ten times that with two masses in a joint
PROFILES = {
    "quick": Profile(1, ("simultaneous_steps", "line_50", "slow_reversals"), ("effects",), 1, 3, 2000, 4),
    "standard": Profile(5, (), ("simultaneous_steps", "effects"), 3, 5, 5000, None),
    "full": Profile(20, (), ("simultaneous_steps", "line_50", "effects"), 10, 7, 10000, None),
}
