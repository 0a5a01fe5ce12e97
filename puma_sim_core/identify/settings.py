# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Every threshold of the identification, stage by stage, each with its source.

A source is a derivation, a citation, or the calibration set that the value was chosen on ("calibrated on seeds X to
Y"). No threshold is moved on a log whose result is then reported.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Data:
    """Stage 1: reading and sampling of logs (`identify.data`)."""


@dataclass(frozen=True)
class Checks:
    """Stage 0: faults of the data (`identify.checks`)."""


@dataclass(frozen=True)
class Noise:
    """Stage 3: noise of residuals and innovations (`identify.noise`)."""


@dataclass(frozen=True)
class Screening:
    """Stages 2 and 4: residual, evidence, short list (`identify.screening`)."""


@dataclass(frozen=True)
class Fitting:
    """Stage 6: hypotheses in the model, fitted to innovations (`identify.fitting`)."""


@dataclass(frozen=True)
class Selection:
    """Stages 5 and 7: which effects are named, validation (`identify.selection`)."""


@dataclass(frozen=True)
class Residuals:
    """Stage 10: free curves (`identify.residuals`)."""


@dataclass(frozen=True)
class Experiment:
    """Stage 11: the next experiment (`identify.experiment`)."""


DATA = Data()
CHECKS = Checks()
NOISE = Noise()
SCREENING = Screening()
FITTING = Fitting()
SELECTION = Selection()
RESIDUALS = Residuals()
EXPERIMENT = Experiment()
