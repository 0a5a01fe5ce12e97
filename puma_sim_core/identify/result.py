# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What `explain` gives: the verdict, the effects with their evidence, the errors, the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isinf

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.settings import REPORT

NOTHING_MISSING = "NOTHING_MISSING"
NAMED = "NAMED"
NAMED_WITH_REMAINDER = "NAMED_WITH_REMAINDER"
UNNAMED = "UNNAMED"
DATA_FAULT = "DATA_FAULT"
VERDICTS = (NOTHING_MISSING, NAMED, NAMED_WITH_REMAINDER, UNNAMED, DATA_FAULT)

NOT_EXCITED = "NOT_EXCITED"

#: rows that errors are measured at: fitted, not fitted, of these those that the choice of effects has not seen, and
#: logs outside the analysis
PARTS = ("fit", "held_out", "unseen", "held_out_logs")


@dataclass(frozen=True)
class Fault:
    """A fault of the data: channel ("time", "voltage2" ...), first row (1-based; None: all), and what is wrong.

    rows : how many rows from that one on cannot be used, 0 where a log cannot be read across the start of the row.
    """

    channel: str
    row: int | None
    what: str
    rows: int = 0

    @classmethod
    def of(cls, channel: str, row: int | None, found: str, expected: str, rows: int = 0) -> Fault:
        """A fault of what was found in place of what was expected."""
        return cls(channel, row, f"{found}; expected {expected}", rows)


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % confidence interval (low, high) and unit. high is infinite where the log bounds it from
    below alone: it fits as well with more than any machine has."""

    value: float
    low: float
    high: float
    unit: str

    @property
    def at_least(self) -> bool:
        """Whether it is bounded from below alone."""
        return isinf(self.high)


@dataclass(frozen=True)
class Hypothesis:
    """An effect on a joint (1-based; None for the whole arm)."""

    name: str
    joint: int | None


@dataclass(frozen=True)
class RuledOut:
    """A hypothesis that the log speaks against, and why."""

    name: str
    joint: int | None
    because: str


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the model lacked: gain of evidence [nat] over the model without it, what the log cannot tell from
    it, and what it can."""

    name: str
    joint: int | None
    parameters: dict[str, Interval]
    evidence: float
    tied_with: tuple[Hypothesis, ...] = ()
    ruled_out: tuple[RuledOut, ...] = ()


@dataclass(frozen=True)
class StageErrors:
    """Errors (J,) of one quantity before and after: root mean squares joint by joint."""

    nominal: Floats
    retuned: Floats
    augmented: Floats
    floor: Floats


@dataclass(frozen=True)
class Errors:
    """voltage_rms [V] of the residual V - Vhat; position_rms [rad or m] of open-loop windows."""

    voltage_rms: StageErrors
    position_rms: StageErrors


#: ways of an axis that remembers: a curve is then over its change since it last reversed
HYSTERESIS, GAP = "with hysteresis", "with the play of one gap"


@dataclass(frozen=True)
class Shape:
    """The shape of what cannot be named.

    axis : "position", "velocity", "time", "voltage", "torque", "acceleration", "position of joint 2", "motor_angle",
    ...; joint (1-based); centre, curve (k,): the residual [V] over the axis, low, high (k,): its 95 % band; line_hz:
    frequency of a spectral line [Hz], None without; ranking: (axis, gain of log evidence) from the best on; way: how
    the axis acts, "" for a plain curve, "with the sign of the velocity", ..., `HYSTERESIS` or `GAP`: the
    curve is then over the change of the axis since it last reversed.
    """

    axis: str
    axis_unit: str
    joint: int
    centre: Floats
    curve: Floats
    low: Floats
    high: Floats
    line_hz: float | None = None
    ranking: tuple[tuple[str, float], ...] = ()
    way: str = ""


@dataclass(frozen=True)
class Detectable:
    """Smallest size of an effect that the log could have shown, in `unit` of `parameter`;
    excited : False where that is larger than any plausible size."""

    name: str
    joint: int | None
    parameter: str
    size: float
    unit: str
    excited: bool


@dataclass(frozen=True)
class Ranked:
    """A row of the ranking.

    evidence [nat] : of an effect found, its gain over the model without it; of a hypothesis that could stand in for one
    (`against`), its gain in that place; of another one, what it would add to the last model in which it was tried.
    verdict : "named", "tied", or why it is neither; possible : whether its fit has sizes that a machine may have.
    """

    name: str
    joint: int | None
    evidence: float
    verdict: str
    against: Hypothesis | None = None
    possible: bool = True


@dataclass(frozen=True)
class Drawn:
    """Series for the figures of a report, decimated: time (m,) [s]; residuals (m, J) [V] of the nominal, retuned and
    augmented model; signals {name: (m, J)} to draw them against; held_out (m,): 1 where the row was not used to fit;
    whiteness {joint: (lags s, autocorrelation, bound)}."""

    time: Floats
    nominal: Floats
    retuned: Floats
    augmented: Floats
    signals: dict[str, Floats]
    held_out: Floats
    whiteness: dict[int, tuple[Floats, Floats, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class FeedbackBias:
    """Test for feedback in the recording (Durbin, Wu, Hausman): p_value small where delay and
    elasticity are biased by it; joint by joint."""

    statistic: Floats
    p_value: Floats
    biased: bool
    instruments: str
    sentence: str


@dataclass(frozen=True)
class NextExperiment:
    """The excitation that would tell what this log leaves open; `command` writes it."""

    sentence: str
    separate: tuple[Hypothesis, ...]
    command: str


@dataclass(frozen=True)
class AgreementOfSize:
    """One parameter as each log alone gives it (None: not, or without bounds); where several do, their weighted mean,
    Cochran's Q, its p-value, and I2, the share of the scatter that the intervals do not explain. law : values of what
    the construction gives of the effect; logs that ask for another law have another size."""

    parameter: str
    unit: str
    found: tuple[Interval | None, ...]
    mean: Interval | None = None
    q: float | None = None
    p_value: float | None = None
    i2: float | None = None
    law: Mapping[str, float] = field(default_factory=dict)

    @property
    def law_words(self) -> str:
        """The law, such as "transmitted 1"; empty where an effect has but one."""
        return ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in self.law.items())

    @property
    def agrees(self) -> bool:
        """Whether the intervals allow one value, at a level of 5 %."""
        return self.p_value is None or self.p_value >= REPORT.agreement


@dataclass(frozen=True)
class AgreementOfEffect:
    """What each log alone says of an effect: "named", "tied", "not named", "not excited" or "no answer"; its sizes."""

    name: str
    joint: int | None
    states: tuple[str, ...]
    sizes: tuple[AgreementOfSize, ...]


@dataclass(frozen=True)
class Agreement:
    """The answers of several logs of one machine, each explained alone; states and sizes are in the order of `logs`."""

    logs: tuple[str, ...]
    verdicts: tuple[str, ...]
    effects: tuple[AgreementOfEffect, ...]
    sentence: str


@dataclass(frozen=True)
class LinkEffect:
    """An effect on the link's side: its gain of evidence [nat] over the model without it.

    sensor : "link" or "motor", whose reading is late, None of an effect of the transmission; law : "lag" (of first
    order) or "delay" of these; either_law : whether the log cannot tell the two.
    """

    name: str
    sensor: str | None
    law: str
    parameters: dict[str, Interval]
    evidence: float
    either_law: bool = False


@dataclass(frozen=True)
class LinkSide:
    """How the reading of the sensor on the link's side of a joint (1-based) differs from the motor's.

    before, after : root mean square of the difference [rad or m], below the filter's cutoff, with zero and ratio
    fitted, without and with the effects; held_out_before, held_out_after : the same in blocks that were not fitted to;
    floor : what the steps of two such sensors leave.
    """

    joint: int
    effects: tuple[LinkEffect, ...]
    before: float
    after: float
    held_out_before: float
    held_out_after: float
    floor: float


@dataclass(frozen=True)
class Explanation:
    """All that is found in a log. `model` is the augmented plant, None for a DATA_FAULT."""

    verdict: str
    sentence: str
    effects: tuple[NamedEffect, ...] = ()
    errors: dict[str, Errors] = field(default_factory=dict)  # of some of `PARTS`
    shape: Shape | None = None
    faults: tuple[Fault, ...] = ()
    detectability: tuple[Detectable, ...] = ()
    next_experiment: NextExperiment | None = None
    feedback_bias: FeedbackBias | None = None
    ranking: tuple[Ranked, ...] = ()
    notes: tuple[str, ...] = ()
    drawn: Drawn | None = None
    model: object | None = None
    mechanism: str = "puma560"
    position_unit: str = "rad"  # "m" for an axis that slides
    voltage_unit: str = "V"  # of the drive's input and so of all residuals
    logs: tuple[str, ...] = ()
    held_out_logs: tuple[str, ...] = ()
    #: name -> start, retuned, unit and, where known, the width (standard deviation) of the prior
    parameters: dict[str, tuple[float, float, str, float]] = field(default_factory=dict)
    seconds: float = 0.0
    version: str = ""
    seed: int = 0
    cuts: tuple[Fault, ...] = ()  # faults of rows that the logs were read without
    agreement: Agreement | None = None  # of several logs, each explained alone as well
    link_side: tuple[LinkSide, ...] = ()  # of joints with a second sensor
