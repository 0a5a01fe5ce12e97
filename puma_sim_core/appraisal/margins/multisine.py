# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Margins of any controller from time series: a multisine is added at the plant input of one joint in closed loop.

Nothing is asked of the controller, so that this serves a process over topics as well as an object. The voltage that
the plant gets is u = a + d, d the injected one and a the controller's answer. Both are taken over a period of d, the
second one; at each of its lines S = U / D. Several realisations with other random phases tell what is linear: noise,
friction and limits make S differ from one to the next (Pintelon and Schoukens, System Identification, chapter 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from puma_sim_core.appraisal.margins.margins import NO_MARGINS, Margins, margins_of
from puma_sim_core.checks import check_choice, check_positive, check_shapes, check_whole
from puma_sim_core.errors import ParameterError
from puma_sim_core.simulation.feedback import Controller

#: least coherence of a line: its S is then good to sqrt((1 - 0.95) / 0.95 / realisations), 13 % of three
COHERENCE = 0.95
#: lines of a smaller |S| do not count in the check: there the plant input is small beside noise, far from any margin
_SMALL = 0.5
#: greatest change of a margin, as a share of it, where every other line is left out: the spline through all of them is
#: at least twice as close, that is good to 5 %
_CHANGED = 0.1
_WHERE = "multisine"


@dataclass(frozen=True)
class Multisine:
    """An excitation of random phases, flat over its lines.

    period : of the controller's samples [s]; samples : in one period of the excitation, even; rms [V].
    lowest, highest : frequencies of the lines [Hz], by default from the first to 0.9 of half the sampling rate; lines :
    how many are wanted, evenly spaced over the logarithm of the frequency as far as there are as many.
    lead : samples without excitation at the start; realisations : each one period to settle and one that is measured.

    Raises ParameterError: names what cannot be.
    """

    period: float
    samples: int
    rms: float = 1.0
    lines: int = 80
    lowest: float = 0.0
    highest: float | None = None
    lead: int = 0
    realisations: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        check_positive(self.period, "period", "s", _WHERE)
        check_positive(self.rms, "rms", "V", _WHERE)
        for name, low in (("samples", 16), ("lines", 4), ("lead", 0), ("realisations", 2), ("seed", 0)):
            check_whole(getattr(self, name), name, low, where=_WHERE)
        if self.samples % 2 or len(self.numbers) < 4:
            what = f"{self.samples} samples with {len(self.numbers)} lines"
            raise ParameterError(what, where=_WHERE, expected="an even number of samples with four lines at least")

    @property
    def numbers(self) -> np.ndarray:
        """Numbers of the excited lines, in periods of the excitation."""
        base = 1.0 / (self.samples * self.period)
        highest = 0.45 / self.period if self.highest is None else self.highest
        low, high = max(self.lowest / base, 1.0), min(highest / base, self.samples / 2 - 1.0)
        if not high > low:
            return np.empty(0, dtype=int)
        wanted = np.unique(np.geomspace(low, high, self.lines).round().astype(int))
        return wanted[(wanted >= 1) & (wanted < self.samples // 2)]

    @property
    def frequency(self) -> np.ndarray:
        """(m,) of the lines [rad/s]."""
        return 2.0 * np.pi * self.numbers / (self.samples * self.period)

    def signal(self) -> np.ndarray:
        """(n,) volts, one a sample of the controller: the lead, then each realisation twice."""
        phases = np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, (self.realisations, len(self.numbers)))
        spectrum = np.zeros((self.realisations, self.samples // 2 + 1), dtype=complex)
        # the rms of a sum of m sines of one amplitude
        spectrum[:, self.numbers] = (
            0.5 * self.samples * self.rms * np.sqrt(2.0 / len(self.numbers)) * np.exp(1j * phases)
        )
        once = np.fft.irfft(spectrum, self.samples, axis=1)
        return np.concatenate([np.zeros(self.lead), np.concatenate([once, once], axis=1).ravel()])


class Injection(NamedTuple):
    """What an injection tells: margins, and line by line frequency (m,) [rad/s], S (m,), coherence (m,).

    trusted : whether the coherence is `COHERENCE` at least, wherever |S| is half or more, |L| > 1 at the lowest line,
    and every other line gives the same margins. Where not they mean nothing: the loop is not linear at this size of the
    excitation, too noisy, slow beside the excitation's period, or does not answer, as a joint that sticks.
    """

    margins: Margins
    frequency: np.ndarray
    sensitivity: np.ndarray
    coherence: np.ndarray
    trusted: bool


def injection_margins(design: Multisine, answered: np.ndarray | Sequence[float]) -> Injection:
    """Margins of the loop of one joint.

    answered : (n,) [V] what the controller asked for at the design's samples, without what was injected; of a trial
    that ended early the samples that there are: its margins are `NO_MARGINS`.

    Raises ParameterError: no samples, or more than the design has.
    """
    (given,) = check_shapes("(n,)", _WHERE, answered=answered)
    injected, m = design.signal(), len(design.numbers)
    if not 0 < len(given) <= len(injected):
        raise ParameterError(
            f"{len(given)} samples", where=_WHERE, expected=f"{len(injected)}, or fewer of a failed trial"
        )
    if len(given) < len(injected):
        nothing = np.zeros(m)
        return Injection(NO_MARGINS, design.frequency, nothing.astype(complex), nothing, False)
    shape = (design.realisations, 2, design.samples)
    D, U = (
        np.fft.rfft(values[design.lead :].reshape(shape)[:, 1], axis=1)[:, design.numbers]
        for values in (injected, injected + given)
    )
    cross, power = (U * D.conj()).sum(axis=0), (np.abs(D) ** 2).sum(axis=0)
    S = cross / power
    coherence = np.abs(cross) ** 2 / (power * np.maximum((np.abs(U) ** 2).sum(axis=0), 1e-300))
    # with |L| > 1 at the lowest line the crossover lies within the lines
    answers = abs(1.0 - S[0]) > abs(S[0])
    margins = margins_of(design.frequency, S)
    linear = answers and (coherence[np.abs(S) >= _SMALL] >= COHERENCE).all()
    return Injection(margins, design.frequency, S, coherence, bool(linear and _resolved(design.frequency, S, margins)))


def _resolved(frequency: np.ndarray, S: np.ndarray, margins: Margins) -> bool:
    """Whether the lines are dense enough for a spline through them."""
    some = np.unique(np.append(np.arange(0, len(S), 2), len(S) - 1))
    if len(some) < 4:
        return False
    return bool(np.isclose(margins_of(frequency[some], S[some]), margins, rtol=_CHANGED, atol=0.0).all())


class Injected:
    """A controller object with a signal added to what it asks of one joint; `answered` is what it asked itself.

    controller : of three joints; joint : 1, 2 or 3; signal : (n,) [V], one a sample, zero behind its end.
    """

    def __init__(self, controller: Controller, joint: int, signal: np.ndarray):
        check_choice(joint, "joint", (1, 2, 3), _WHERE)
        self.period = controller.period
        self._controller, self._joint, self._signal = controller, joint - 1, np.asarray(signal, dtype=float).tolist()
        self.answered: list[float] = []

    def reset(self) -> None:
        """Forget the past, and begin with the signal again."""
        self._controller.reset()
        self.answered = []

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts of the controller for one sample, with the signal's added."""
        volts = list(map(float, self._controller.update(t, setpoint, measurement)))
        k = len(self.answered)
        self.answered.append(volts[self._joint])
        if k < len(self._signal):
            volts[self._joint] += self._signal[k]
        return tuple(volts)
