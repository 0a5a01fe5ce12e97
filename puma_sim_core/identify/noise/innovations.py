# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The noise of innovations: its spectrum, and the filter that whitens it.

A filter fitted to whiten any innovations would also remove a spectral line, or a slow effect. Here their spectrum is
that of a few physical sources as the Kalman predictor passes them on: voltages and positions with white noise, and
disturbances with correlation times of 5 to 160 ms. Weights are fitted to medians over bands, which a line does not
move. The filter is the causal one of minimum phase (Oppenheim and Schafer, Discrete-Time Signal Processing, chapter on
cepstral analysis).
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.optimize import nnls

from puma_sim_core.identify.arrays import Floats, log_rows, runs
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting, folded_response
from puma_sim_core.identify.settings import NOISE


@dataclass(frozen=True)
class Noise:
    """The noise of one joint: taps of the filter that whitens it, and the log likelihood of the innovations [nat]."""

    taps: Floats
    log_likelihood: float


def weighting(predictor: Predictor, errors: Floats, before: Weighting | None = None) -> Weighting:
    """The whitening filter of each joint for noise with the spectrum of its innovations.

    errors (N, J) : the innovations, in the weighting `before`, which is undone; only rows to fit are read.
    """
    filters = np.array([noise(predictor, errors[:, j], j, before).taps for j in range(errors.shape[1])])
    return Weighting(filters, np.ones(len(filters)), predictor.lengths, predictor.settling)


def noise(predictor: Predictor, errors: Floats, j: int, before: Weighting | None = None) -> Noise:
    """The noise of joint j (0-based) by innovations (N,), as `weighting`."""
    step = predictor.step
    size = fft.next_fast_len(2 * int(NOISE.spectrum_longest / step), real=True)
    frequency = fft.rfftfreq(size, step)
    spectra = _sources(predictor, j, frequency)
    passed = np.ones(len(frequency))
    if before is not None:
        passed = np.abs(folded_response(before.filters[j], size) / before.scale[j]) ** 2
    f, power = _periodogram(predictor, errors, j)
    weights = _weights(frequency, spectra * passed, f, power)
    # of rounding, and of a sensor whose joint rests
    volts = predictor.least[j] ** 2 * np.abs(folded_response(predictor.responses[j], size)) ** 2
    spectrum = weights @ spectra + 2.0 * step * (volts + predictor.unshown[j] ** 2)
    likelihood = 0.0
    if len(f):
        model = np.interp(f, frequency, spectrum * passed)
        deviance = (np.log(model) + np.minimum(power / model, NOISE.spectrum_outlying)).sum()
        likelihood = -NOISE.spectrum_independent * float(deviance)
    return Noise(_whitening(spectrum, step, size), likelihood)


def _sources(predictor: Predictor, j: int, frequency: Floats) -> Floats:
    """(k, f) spectra [rad^2/Hz] of unit sources in the innovations of a joint."""
    step, response = predictor.step, predictor.responses[j]
    passed = np.abs(folded_response(response, 2 * (len(frequency) - 1))) ** 2
    white = np.full(len(frequency), 2.0 * step)
    # with both noises as the predictor assumes them, innovations are white: less the voltage's, the sensor's is left
    volts = white * passed
    assumed = white * predictor.spread[j] ** 2
    sensor = np.maximum(assumed - predictor.volts[j] ** 2 * volts, 1e-3 * assumed)
    parts = [assumed, sensor, volts]
    for time in NOISE.spectrum_lasting:
        decay = np.exp(-step / time)
        parts.append(volts * (1.0 - decay**2) / np.abs(1.0 - decay * np.exp(-2j * np.pi * frequency * step)) ** 2)
    for centre in NOISE.spectrum_humps:
        if centre * step < NOISE.spectrum_highest_hump:
            # no segment resolves what is slower: a hump that went to zero there would leave slow errors without noise
            resolved = np.maximum(frequency, NOISE.spectrum_resolved / NOISE.spectrum_longest)
            away = resolved / centre - centre / resolved
            parts.append(volts / (1.0 + (NOISE.spectrum_quality * away) ** 2))
    # each of a unit's variance, so that weights are of one size
    spectra: Floats = np.array(parts)
    return spectra / spectra.mean(axis=1, keepdims=True)


def _periodogram(predictor: Predictor, errors: Floats, j: int) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and power [rad^2/Hz] of the rows to fit, in the order of the frequencies.

    Runs are cut into overlapping segments (Welch 1967, IEEE Trans. Audio Electroacoust. 15:70): what happens in one of
    them, such as an impact, moves no median. Segments count in which the joint moves for
    half as long as in the one where it moves longest.
    """
    step, fitted, noisy = predictor.step, predictor.fit_rows[:, j], predictor.noisy_rows[:, j]
    found, moving = [], list[float]()
    for rows in log_rows(predictor.lengths):
        for a, b in runs(fitted[rows]):
            for first, last in _segments(a, b, round(NOISE.spectrum_longest / step)):
                if (last - first) * step >= NOISE.spectrum_shortest:
                    taper = np.hanning(last - first)
                    power = np.abs(np.fft.rfft(errors[rows][first:last] * taper)) ** 2
                    density = power[1:] * 2.0 * step / (taper @ taper)
                    found.append((fft.rfftfreq(last - first, step)[1:], density))
                    moving.append(float(noisy[rows][first:last].mean()))
    if not found:
        return np.zeros(0), np.zeros(0)
    counted = [pair for pair, share in zip(found, moving) if 2.0 * share >= max(moving)]
    f, p = (np.concatenate(parts) for parts in zip(*counted))
    order = np.argsort(f, kind="stable")
    return f[order], p[order]


def _segments(first: int, last: int, longest: int) -> list[tuple[int, int]]:
    """Segments of a run of rows, of equal length up to `longest`, each from the middle of the one before."""
    count = max(1, int(np.ceil(2.0 * (last - first) / longest)) - 1)
    length = 2.0 * (last - first) / (count + 1)
    starts = first + 0.5 * length * np.arange(count)
    return [(round(start), round(start + length)) for start in starts.tolist()]


def _weights(frequency: Floats, spectra: Floats, f: Floats, power: Floats) -> Floats:
    """(k,) weights of the sources by medians over bands, relative to the spectrum (Whittle)."""
    medians, means, start = [], [], 0
    while start < len(f):
        stop = int(np.searchsorted(f, f[start] + max(NOISE.spectrum_band, NOISE.spectrum_share * f[start])))
        stop = max(stop, start + NOISE.spectrum_least_lines)
        if len(f) - stop < NOISE.spectrum_least_lines:
            stop = len(f)
        # the median of the exponential distribution is log(2) of its mean
        medians.append(float(np.median(power[start:stop])) / np.log(2.0))
        inside = (frequency >= f[start]) & (frequency <= f[stop - 1])
        if inside.any():
            means.append(spectra[:, inside].mean(axis=1))
        else:
            means.append(np.array([np.interp(0.5 * (f[start] + f[stop - 1]), frequency, s) for s in spectra]))
        start = stop
    only = np.zeros(len(spectra))
    if not medians or not max(medians) > 0.0:
        only[0] = 1e-30
        return only
    measured, design = np.maximum(medians, 1e-12 * max(medians)), np.array(means)
    model, weights = measured, only
    for _ in range(NOISE.rounds):
        try:
            weights, _ = nnls(design / model[:, None], measured / model, maxiter=NOISE.spectrum_steps)
        except RuntimeError:  # sources that are nearly the same: the weights of before will do
            break
        model = np.maximum(0.5 * model + 0.5 * design @ weights, 1e-6 * measured)
    return weights if weights.any() else only + measured.mean() / len(only)


def _whitening(spectrum: Floats, step: float, size: int) -> Floats:
    """(size / 2,) taps of the causal filter that whitens noise of a spectrum [1/Hz], to variance 1."""
    floor = 1e-9 * float(spectrum.max())
    cepstrum = fft.irfft(-0.5 * np.log(np.maximum(spectrum, floor) / (2.0 * step)), size)
    half = size // 2
    cepstrum[1:half] *= 2.0
    cepstrum[half + 1 :] = 0.0
    return fft.irfft(np.exp(fft.rfft(cepstrum)), size)[:half]
