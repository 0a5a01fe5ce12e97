# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 3: noise of residuals and innovations (`identify.noise`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Noise:
    """Thresholds of this stage."""

    rounds: int = 12  #: rounds of a fit of spectral weights

    # --- `residual`
    residual_lasting: tuple[float, ...] = (0.010, 0.040, 0.160)  #: correlation times of disturbances [s]
    residual_least: float = 1e-4  #: least standard deviation of the white voltage noise [V] in the band
    residual_band: float = 1.5  #: width of a band of the periodogram [Hz]
    residual_least_lines: int = 6  #: its least number of frequencies
    residual_least_bands: int = 3  #: least number of bands
    residual_least_rows: int = 32  #: least rows of a log
    residual_top: float = 1.15  #: top of the bands, in the second cutoff
    #: share of the variance added to the diagonal: filtered rows are nearly dependent
    residual_jitter: float = 2e-3
    residual_block: int = 1500  #: rows of one block of the covariance; longer stretches are cut

    # --- `innovations`
    spectrum_lasting: tuple[float, ...] = (0.005, 0.010, 0.020, 0.040, 0.080, 0.160)  #: disturbances [s]
    #: disturbances about a frequency [Hz], such as a drive's own controller makes, an octave apart
    spectrum_humps: tuple[float, ...] = (2.0, 4.0, 8.0, 16.0, 32.0)
    spectrum_quality: float = 2.0  #: of the resonance that makes them: they are as wide as they are apart
    spectrum_highest_hump: float = 0.4  #: highest of them, in the sampling frequency
    #: frequency below which a hump does not fall, in 1/(longest filter): half the main lobe of a Hann window, the
    #: resolution of the periodograms (Harris 1978, Proc. IEEE 66:51). Falling to zero, humps that took the place of the
    #: disturbances left joint 3 of seed 970009 a fortieth of its power below 1 Hz, and the fit followed that noise
    spectrum_resolved: float = 2.0
    spectrum_band: float = 1.0  #: least width of a band [Hz]
    spectrum_share: float = 0.15  #: and as a share of its frequency
    spectrum_least_lines: int = 6  #: least number of lines in it
    spectrum_shortest: float = 0.3  #: shortest stretch of rows that gives a periodogram [s]
    spectrum_steps: int = 300  #: steps of a fit of weights
    spectrum_longest: float = 1.5  #: longest filter [s]
    spectrum_independent: float = 0.5  #: share of a tapered periodogram's lines that are independent
    spectrum_outlying: float = 8.0  #: most that one counts as, over the spectrum

    # --- `weighting`
    whitening_direct: int = 64  #: taps up to which a filter is run row by row


NOISE = Noise()
