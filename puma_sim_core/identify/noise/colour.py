# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The colour of the noise in innovations: what remains is judged against it (step 3).

A filter that makes any innovations white would take a line, or what changes slowly, out of sight.
Here their spectrum is that of a few physical sources as the observer passes them on: voltages and
positions with white noise, and disturbances that last 5 to 160 ms. Weights are fitted to medians
over bands, which a line does not move. The filter is the causal one of minimum phase
(Oppenheim and Schafer, Discrete-Time Signal Processing, chapter on cepstral analysis).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.optimize import nnls

from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.settings import NOISE


@dataclass(frozen=True)
class Noise:
    """The noise of one joint: taps of the filter that makes it white, and the log likelihood of
    what it was measured on [nat]."""

    taps: np.ndarray
    log_likelihood: float


def weighting(predictor: Predictor, errors: np.ndarray, before: Weighting | None = None) -> Weighting:
    """The filter of each joint that makes noise with the spectrum of its innovations white.

    errors (N, J) : the innovations, in the weighting `before`, which is undone; only rows to fit
    are read.
    """
    filters = np.array([noise(predictor, errors[:, j], j, before).taps for j in range(errors.shape[1])])
    return Weighting(filters, np.ones(len(filters)), predictor.lengths)


def noise(predictor: Predictor, errors: np.ndarray, j: int, before: Weighting | None = None) -> Noise:
    """The noise of joint j (0-based) by innovations (N,), as `weighting`."""
    size = fft.next_fast_len(2 * int(NOISE.spectrum_longest / predictor.step), real=True)
    frequency = fft.rfftfreq(size, predictor.step)
    spectra = _sources(predictor, j, frequency)
    passed = (
        np.ones(len(frequency)) if before is None else np.abs(_response(before.filters[j], size) / before.scale[j]) ** 2
    )
    f, power = _periodogram(predictor, errors, j)
    weights = _weights(frequency, spectra * passed, f, power)
    spectrum = (
        weights @ spectra
        + 2.0 * predictor.step * predictor.least[j] ** 2 * np.abs(_response(predictor.responses[j], size)) ** 2
    )
    likelihood = 0.0
    if len(f):
        model = np.interp(f, frequency, spectrum * passed)
        likelihood = -NOISE.spectrum_independent * float(
            (np.log(model) + np.minimum(power / model, NOISE.spectrum_outlying)).sum()
        )
    return Noise(_whitening(spectrum, predictor.step, size), likelihood)


def _response(taps, size) -> np.ndarray:
    """(size / 2 + 1,) complex response of a filter at the frequencies of a transform."""
    folded = np.zeros(-(-len(taps) // size) * size)
    folded[: len(taps)] = taps
    return np.fft.rfft(folded.reshape(-1, size).sum(axis=0))


def _sources(predictor, j, frequency) -> np.ndarray:
    """(k, f) spectra [rad^2/Hz] of unit sources in the innovations of a joint."""
    step = predictor.step
    response = predictor.responses[j]
    passed = np.abs(_response(response, 2 * (len(frequency) - 1))) ** 2
    white = np.full(len(frequency), 2.0 * step)
    # with both noises as reckoned with, innovations are white: the voltage leaves the sensor's
    volts = white * passed
    known = white * predictor.spread[j] ** 2
    sensor = np.maximum(known - predictor.volts[j] ** 2 * volts, 1e-3 * known)
    parts = [known, sensor, volts]
    for time in NOISE.spectrum_lasting:
        keep = np.exp(-step / time)
        parts.append(volts * (1.0 - keep**2) / np.abs(1.0 - keep * np.exp(-2j * np.pi * frequency * step)) ** 2)
    # each of a unit's variance, so that weights are of one size
    parts = np.array(parts)
    return parts / parts.mean(axis=1, keepdims=True)


def _periodogram(predictor, errors, j) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and power [rad^2/Hz] of all continuous stretches of rows to fit."""
    step, rows = predictor.step, predictor.fit_rows[:, j]
    found, start = [], 0
    for n in predictor.lengths:
        good = np.r_[0, rows[start : start + n].astype(int), 0]
        change = np.flatnonzero(np.diff(good))
        for a, b in zip(change[::2], change[1::2]):
            if (b - a) * step < NOISE.spectrum_shortest:
                continue
            taper = np.hanning(b - a)
            power = np.abs(np.fft.rfft(errors[start + a : start + b] * taper)) ** 2
            found.append((np.fft.rfftfreq(b - a, step)[1:], power[1:] * 2.0 * step / (taper @ taper)))
        start += n
    if not found:
        return np.zeros(0), np.zeros(0)
    f, p = (np.concatenate(parts) for parts in zip(*found))
    order = np.argsort(f, kind="stable")
    return f[order], p[order]


def _weights(frequency, spectra, f, power) -> np.ndarray:
    """(k,) weights of the sources by medians over bands, relative to the spectrum (Whittle)."""
    measured, design = [], []
    start = 0
    while start < len(f):
        stop = int(np.searchsorted(f, f[start] + max(NOISE.spectrum_band, NOISE.spectrum_share * f[start])))
        stop = max(stop, start + NOISE.spectrum_least_lines)
        if len(f) - stop < NOISE.spectrum_least_lines:
            stop = len(f)
        measured.append(float(np.median(power[start:stop])) / np.log(2.0))
        inside = (frequency >= f[start]) & (frequency <= f[stop - 1])
        design.append(
            spectra[:, inside].mean(axis=1)
            if inside.any()
            else np.array([np.interp(0.5 * (f[start] + f[stop - 1]), frequency, s) for s in spectra])
        )
        start = stop
    only = np.zeros(len(spectra))
    if not measured or not max(measured) > 0.0:
        only[0] = 1e-30
        return only
    measured, design = np.maximum(measured, 1e-12 * max(measured)), np.array(design)
    model = measured
    weights = only
    for _ in range(12):
        try:
            weights, _ = nnls(design / model[:, None], measured / model, maxiter=NOISE.spectrum_steps)
        except RuntimeError:  # sources that are nearly the same: the weights of before will do
            break
        model = np.maximum(0.5 * model + 0.5 * design @ weights, 1e-6 * measured)
    return weights if weights.any() else only + measured.mean() / len(only)


def _whitening(spectrum, step, size) -> np.ndarray:
    """(size / 2,) taps of the causal filter that makes noise of a spectrum [1/Hz] white and of
    variance 1."""
    floor = 1e-9 * float(spectrum.max())
    logarithm = -0.5 * np.log(np.maximum(spectrum, floor) / (2.0 * step))
    cepstrum = fft.irfft(logarithm, size)
    half = size // 2
    cepstrum[1:half] *= 2.0
    cepstrum[half + 1 :] = 0.0
    return fft.irfft(np.exp(fft.rfft(cepstrum)), size)[:half]
