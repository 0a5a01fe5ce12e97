# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 12: the link's side compared with the motor's (`identify.link_side`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LinkSide:
    """Thresholds of this stage, by hand and by derivation; none was set on a log.

    What a name needs is as in `SELECTION`.
    """

    cutoff: float = 10.0  #: of the filter [Hz]: below the resonances of transmissions, above the motion of machines
    cutoff_share: float = 0.2  #: its greatest share of the sampling frequency
    kept: float = 2.6  #: rows kept after the filter, in multiples of its cutoff, as in `DATA`

    # --- priors, standard deviations about zero
    late: float = 0.01  #: of the time by which a reading is late [s]: a bus cycle, or a filter, of some milliseconds
    latest: float = 10.0 * late  #: up to which a delay is sought [s]: far beyond what its prior allows
    ratio: float = 1e-3  #: of the ratio of the two readings less 1: gears are counted, encoders are divided finely
    #: of an offset, in the joint's range: zeros are arbitrary
    offset: float = 1.0

    # --- the noise is integrated over a grid
    #: correlation times of the disturbance [s], three a decade from a row to the length of a motion
    lasting: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    white: tuple[float, ...] = (0.5, 0.1, 0.01, 1e-3)  #: shares of white noise in its variance, beside all of it
    #: of its standard deviation: from that of a resolution, or a share of the readings' difference, on; ratio of two
    least_deviation: float = 1e-4
    deviation_ratio: float = 1.15

    rounds: int = 3  #: fits about the time found, which a delay is not linear in
    most_effects: int = 2  #: most effects of a joint
    least_row_share: float = 0.02  #: of a column's spread about what is always fitted: less is no action of it
    folds: int = 4  #: folds of the cross-validation, of blocks as in `SCREENING`


LINK_SIDE = LinkSide()
