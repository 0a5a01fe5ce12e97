# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 1: reading and sampling of logs (`identify.data`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Data:
    """Thresholds of this stage."""

    filter_order: int = 8  #: half of the exponent of the response
    filter_settling: float = 2.5  #: time constants 1/fc that the response takes to die away

    reading_greatest_rows: int = 60_000  #: rows of a log that are read: a minute at 1 kHz takes 3.7 GB (an arm)

    #: stamps of a clock whose ticks are longer than a row: share of a tick by which its ticks may differ, as 15.6 and
    #: 15.7 ms of one of 15.625 ms do, and the stamps leave a straight line by more than a tick; ticks that there are at
    #: least; and how often a row with the stamp of the one before has a new position, as a share of how often others
    #: have: 0 of positions that were read once a tick, 1 of all others
    clock_even: float = 0.1
    clock_ticks: int = 30
    clock_moved: float = 0.5

    bend_most: float = 100.0  #: greatest squared bend of a position that counts for a clock, in encoder steps squared
    bend_ratio: float = 1.5  #: squared bends over those by another clock, where stamps are not the times of positions
    late_gain: float = 16.0  #: nat by which rows that come late must show when positions were read, as a name must

    encoder_changes: int = 20  #: least changes of a position in which an encoder's step is found
    #: fewer show it where they are in at most this share of the rows: a reading without steps changes in every row
    encoder_repeated: float = 0.5
    encoder_reaches: tuple[float, ...] = (1.5, 4.0, 15.0)  #: steps that changes are taken up to
    #: time to either side of a row [s] in which a reading that stays within a step of its encoder shows no noise:
    #: longer than a reversal lasts, and than the longest correlation time of the noise (0.16 s) within both
    encoder_rest: float = 0.15
    encoder_blurred: float = 0.01  #: of a step, by which the digits of a text blur it

    sampling_first_cutoff: float = 60.0  #: first filter [Hz]
    sampling_first_share: float = 0.30  #: its greatest share of the sampling frequency
    sampling_second_cutoff: float = 25.0  #: second filter [Hz]
    sampling_second_share: float = 0.42  #: its greatest share of the first
    sampling_kept: float = 2.6  #: rows kept after the second filter, in multiples of its cutoff
    sampling_even: float = 0.02  #: steps of time that differ by less than this share count as even
    #: decimals of the mean of `enable` over a step: its rounding reaches 5e-12 in 60000 uneven rows, at 1 kHz
    enable_digits: int = 9


DATA = Data()
