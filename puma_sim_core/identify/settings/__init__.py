# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Every threshold of the identification, a file for each stage, each with its source.

A source is a derivation, a citation, or the calibration set that the value was chosen on. No threshold is moved on a
log whose result is then reported.

[calibrated] : set on scores of records of the generator in test/blind, seeds 2000 to 2999 and 900000 to 906339, none of
which any reported figure comes from (README); nothing more exact is on record.
No source : chosen by hand or on synthetic development records.

A comment on a line of its own is of the settings below it, in their order; names begin with their module's.
"""

from puma_sim_core.identify.settings.checks import CHECKS
from puma_sim_core.identify.settings.data import DATA
from puma_sim_core.identify.settings.experiment import EXPERIMENT
from puma_sim_core.identify.settings.fitting import FITTING
from puma_sim_core.identify.settings.link_side import LINK_SIDE
from puma_sim_core.identify.settings.noise import NOISE
from puma_sim_core.identify.settings.report import REPORT
from puma_sim_core.identify.settings.residuals import RESIDUALS
from puma_sim_core.identify.settings.screening import SCREENING
from puma_sim_core.identify.settings.selection import SELECTION

__all__ = (
    "CHECKS",
    "DATA",
    "EXPERIMENT",
    "FITTING",
    "LINK_SIDE",
    "NOISE",
    "REPORT",
    "RESIDUALS",
    "SCREENING",
    "SELECTION",
)
