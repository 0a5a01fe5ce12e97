# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the report says of numbers, and draws (`identify.report`); none of it decides which effects are named."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Report:
    """Thresholds of the report."""

    agreement: float = 0.05  #: p-value below which sizes of several logs do not agree: the usual level of a test
    #: relative difference of what the construction gives of an effect up to which its law is the same [by hand]: poses
    #: change the share of the links in the inertia, and the size changes by a tenth at most with it
    same_law: float = 0.1
    changed: float = 1.05  #: ratio of two errors from which they are told apart
    far: float = 2.5  #: change of a parameter that is marked [standard deviations of its prior]
    bins: int = 30  #: in which a mean over a quantity is drawn
    bin_rows: int = 6  #: that such a mean needs to be drawn


REPORT = Report()
