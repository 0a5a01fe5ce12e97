# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the log could have shown: the smallest size of each effect that would have been named.

A coefficient of size c along a column with X'PX = G raises the log evidence by c^2 G / 2 less the Occam factor of its
prior. The size where that reaches the threshold of a name is the smallest that the log could show; where it is larger
than any that the machine may have, the log does not excite the effect.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from puma_sim_core.effects import Effect, Kind
from puma_sim_core.effects.screening import Candidate, Illegal
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.result import Detectable
from puma_sim_core.plant.mechanism import Mechanism


def detectable(
    kind: Kind,
    joint: int | None,
    mechanism: Mechanism,
    period: float,
    pairs: Iterable[tuple[Candidate, Floats]],
    threshold: float,
    found: Effect | None = None,
) -> Detectable:
    """The row of one hypothesis.

    joint : 1-based; period : of the log [s]; pairs : (candidate, X'PX of its columns); threshold : gain of log
    evidence of a name [nat]; found : the effect as the log shows it, None where it does not.
    """
    parameter = kind.parameter(next((name for name, _, _ in kind.plausible), kind.parameters[0].name))
    sizes = [size for c, G in pairs for size in _sizes(c, G, parameter.name, threshold)]
    # a small stiffness is a great effect: there the largest value that shows is the limit
    least = max if parameter.inverse else min
    size = least(sizes, default=np.inf)
    if found is not None:
        shown = abs(found.values[parameter.name])
        size = shown if not np.isfinite(size) else least(size, shown)
    low, high = mechanism.plausible(parameter, None if joint is None else joint - 1, period) or (0.0, np.inf)
    excited = found is not None or bool(np.isfinite(size) and (size >= low if parameter.inverse else size <= high))
    return Detectable(kind.name, joint, parameter.name, float(size), mechanism.unit(parameter.unit), excited)


def _sizes(c: Candidate, G: Floats, parameter: str, threshold: float) -> Sequence[float]:
    """The value of the parameter at which this candidate would be named, none if it would not."""
    # along the coefficients of a typical effect
    coefficients = np.where(c.mean != 0.0, c.mean, c.deviation)
    if c.fixed:
        coefficients = c.mean
        if 0.5 * float(c.mean @ G @ c.mean) < threshold:
            return ()
    else:
        occam = 0.5 * float(np.linalg.slogdet(np.eye(len(G)) + c.deviation[:, None] * G * c.deviation)[1])
        power = float(coefficients @ G @ coefficients)
        if not power > 0.0:
            return ()
        coefficients = np.sqrt(2.0 * (threshold + occam) / power) * coefficients
    try:
        values = c.values(coefficients)
    except Illegal:
        return (np.inf,)  # larger than the legal range: certainly not excited
    return (abs(values[parameter]),) if parameter in values else ()
