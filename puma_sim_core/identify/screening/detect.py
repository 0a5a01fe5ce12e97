# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the log could have shown: the smallest size of each effect that would have been named.

A coefficient of size c along a column with X'PX = G raises the log evidence by c^2 G / 2 less the
price of its prior. The size where that reaches the threshold of a name is the smallest that
the log could show; where it is larger than any plausible size, the log does not excite the
effect, and says nothing of it.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects.screening import Illegal
from puma_sim_core.identify.result import Detectable


def detectable(name: str, joint: int | None, kind, pairs, threshold: float) -> Detectable:
    """The row of one hypothesis.

    pairs : (candidate, X'PX of its columns); threshold : gain of log evidence of a name [nat].
    """
    limits = {p: (low, high) for p, low, high in kind.plausible}
    parameter = next(iter(limits), kind.parameters[0].name)
    unit = next(p.unit for p in kind.parameters if p.name == parameter)
    sizes = [_size(c, G, parameter, threshold) for c, G in pairs]
    sizes = [size for size in sizes if size is not None]
    # a small stiffness is a great effect: there the largest value that shows is the limit
    falling = kind.parameter(parameter).inverse
    size = (max(sizes) if falling else min(sizes)) if sizes else np.inf
    low, high = limits.get(parameter, (0.0, np.inf))
    excited = bool(np.isfinite(size) and (size >= low if falling else size <= high))
    return Detectable(name, joint, parameter, float(size), unit, excited)


def _size(c, G, parameter, threshold) -> float | None:
    """Value of the parameter at which this candidate would be named, None if it would not."""
    if c.fixed:
        gain = 0.5 * float(c.mean @ G @ c.mean)
        if gain < threshold:
            return None
        return _value(c, c.mean, parameter)
    price = 0.5 * float(np.linalg.slogdet(np.eye(len(G)) + c.deviation[:, None] * G * c.deviation)[1])
    # along the coefficients of a typical effect of this kind
    direction = np.where(c.mean != 0.0, c.mean, c.deviation)
    power = float(direction @ G @ direction)
    if not power > 0.0:
        return None
    scale = np.sqrt(2.0 * (threshold + price) / power)
    return _value(c, scale * direction, parameter)


def _value(candidate, coefficients, parameter) -> float | None:
    try:
        values = candidate.values(coefficients)
    except Illegal:
        # larger than the legal range: certainly not excited
        return np.inf
    return abs(values[parameter]) if parameter in values else None
