# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Filters without phase, and derivatives, by the fast Fourier transform.

Both filters have the response H(f) = 1 / (1 + (f/fc)^8): flat to half of fc, 1/2 at fc, 1/257 at twice fc. A series is
continued beyond its ends by its own point reflection, so that a slope goes on; rows within `edge` of an end still
depend on that and are not used.
"""

from collections.abc import Sequence

import numpy as np
from scipy import fft

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.settings import DATA


def response(frequency: Floats, cutoff: float) -> Floats:
    """H(f) of the filter at frequencies [Hz], without phase; 1/2 at the cutoff [Hz]."""
    return 1.0 / (1.0 + (np.asarray(frequency) / cutoff) ** DATA.filter_order)


def edge(cutoff: float) -> float:
    """Time [s] at each end of a log that a filter of this cutoff [Hz] spoils."""
    return DATA.filter_settling / cutoff


def low_pass(
    values: Floats, step: float, cutoff: float, orders: Sequence[int] = (0,), lag: float = 0.0, delay: float = 0.0
) -> list[Floats]:
    """Derivatives of a filtered series.

    values (n, ...) : samples each `step` [s], along the first axis.
    orders : which derivatives; 0 is the filtered series itself.
    lag : multiplies each by (1 + lag d/dt), `lag` in seconds.
    delay : makes each so many seconds late.

    Returns
    -------
    One array (n, ...) for each of `orders`, in units of values / s^order.
    """
    n = len(values)
    pad = min(n - 1, int(np.ceil(2.0 * edge(cutoff) / step)))
    before = 2.0 * values[:1] - values[pad:0:-1]
    after = 2.0 * values[-1:] - values[-2 : -pad - 2 : -1]
    # a straight line joins the ends: what is transformed is periodic, without a jump
    long = np.concatenate([before, values, after])
    m = len(long)
    slope = (long[-1] - long[0]) / ((m - 1) * step)
    shape = (-1, *(1,) * (values.ndim - 1))
    ramp = (step * np.arange(m)).reshape(shape)
    size = fft.next_fast_len(m, real=True)
    spectrum = fft.rfft(long - long[0] - slope * ramp, size, axis=0)
    frequency = fft.rfftfreq(size, step)
    omega = 2j * np.pi * frequency
    gain = response(frequency, cutoff) * (1.0 + lag * omega) * np.exp(-omega * delay)
    inner = slice(pad, pad + n)
    result = []
    for order in orders:
        part = fft.irfft(spectrum * (gain * omega**order).reshape(shape), size, axis=0)[inner]
        if order == 0:
            part = part + long[0] + slope * (ramp[inner] + lag - delay)
        elif order == 1:
            part = part + slope
        result.append(part)
    return result
