# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The digital joint servo of section 7.6: setpoints each 28 ms, thirty samples in between.

One sample of a joint is a chain: encoder counts, PID, digital-to-analogue converter, power
amplifier (a constant gain). Counts and converter are ideal, and there is no delay, unless they
are asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import floor, inf, pi
from typing import Any

from puma_sim_core.checks import check_positive, check_whole
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import Table, Vec, inlined
from puma_sim_core.servo.pid import PidGains, pid_law

#: numbers that the kernel reads for each joint: Kg, h/Ti, Td/h, limit of the output [V],
#: encoder step [rad], converter step [V], amplifier gain, derivative on the measurement (1.0),
#: delay [samples], output at which the sum stops growing [V] (inf: it never does)
SERVO_WIDTH = 10
#: numbers that one joint's servo remembers: the sum (h/Ti) e, the last d; behind those of the
#: three joints stand the voltages that the delay holds back, joint by joint, the oldest first
MEMORY_WIDTH = 2

#: longest delay [samples], about a second at 28/30 ms
GREATEST_DELAY = 1000

#: Ziegler-Nichols settings from a fifth of the ultimate gains at 28/30 ms (upright, aligned and
#: joint 3), with the periods stretched: well damped, and volts left for the motion
DEFAULT_GAINS = (PidGains(900.0, 0.20, 0.03), PidGains(1600.0, 0.20, 0.03), PidGains(800.0, 0.20, 0.03))


@dataclass(frozen=True)
class ServoConfig:
    """The digital servo of the three joints.

    Attributes
    ----------
    gains : PID gains of each joint; their output is the converter's voltage.
    amplifier_gain : motor volts per converter volt.
    converter_bits : width of the converter, None for an ideal one. Its range is that which gives
        the motor +- the voltage limit.
    encoder_counts : counts a motor turn (the PUMA has 1000), None for an ideal encoder.
    derivative_on_measurement : a step of the setpoint then does not kick.
    anti_windup : an error that would drive a limited output further is not added to the sum.
    delay_samples : samples by which a voltage acts later than the sample that it answers.
    """

    gains: tuple[PidGains, PidGains, PidGains] = DEFAULT_GAINS
    amplifier_gain: float = 1.0
    converter_bits: int | None = None
    encoder_counts: int | None = None
    derivative_on_measurement: bool = True
    anti_windup: bool = True
    delay_samples: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "gains", tuple(self.gains))
        if len(self.gains) != 3 or not all(isinstance(g, PidGains) for g in self.gains):
            raise ParameterError(f"gains {self.gains!r}", where="servo", expected="PidGains of three joints")
        check_positive(self.amplifier_gain, "amplifier_gain", "", "servo")
        for name, low, high in (("converter_bits", 2, 32), ("encoder_counts", 1, 10**8)):
            if getattr(self, name) is not None:
                check_whole(getattr(self, name), name, low, high, "servo")
        check_whole(self.delay_samples, "delay_samples", 0, GREATEST_DELAY, "servo")

    def table(self, period: float, voltage_limit: float, gear_ratios: Table) -> list[float]:
        """The flat table of 3 * SERVO_WIDTH numbers that the kernel reads.

        period : time between samples [s]; voltage_limit : at the motor [V];
        gear_ratios : of the three joints, for the encoders on the motor shafts.
        """
        limit = voltage_limit / self.amplifier_gain
        bits, counts = self.converter_bits, self.encoder_counts
        table = []
        for gains, ratio in zip(self.gains, gear_ratios):
            table += [
                gains.gain,
                period / gains.integral_time,
                gains.derivative_time / period,
                limit,
                0.0 if counts is None else 2.0 * pi / (counts * abs(ratio)),
                0.0 if bits is None or limit == inf else 2.0 * limit / 2.0**bits,
                self.amplifier_gain,
                1.0 if self.derivative_on_measurement else 0.0,
                float(self.delay_samples),
                limit if self.anti_windup else inf,
            ]
        return table

    def held_back(self, voltage: Vec = (0.0, 0.0, 0.0)) -> tuple[float, ...]:
        """The part of the memory that the delay needs, filled with the voltages [V] that were
        asked for before the first sample (none by default)."""
        return tuple(float(v) for v in voltage for _ in range(self.delay_samples))

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for a file."""
        return {**vars(self), "gains": [dict(vars(gains)) for gains in self.gains]}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> ServoConfig:
        """The inverse of `to_mapping`; raises ParameterError."""
        try:
            values: dict[str, Any] = dict(mapping)
            gains = tuple(PidGains(**g) for g in values.pop("gains", ()))
            if gains:
                values["gains"] = gains
            return cls(**values)
        except TypeError as error:
            raise ParameterError(f"{error}", where="servo", expected="the keys of ServoConfig") from None


@inlined
def quantised(value: float, step: float) -> float:
    """Nearest multiple of `step`; the value itself for step 0."""
    return floor(value / step + 0.5) * step if step > 0.0 else value


@inlined
def measured_position(q: float, s: Table, k: int) -> float:
    """Position [rad] as the encoder gives it; k is the joint's place in the servo table s."""
    return quantised(q, s[k + 4])


@inlined
def d_signal(error: float, y: float, s: Table, k: int) -> float:
    """What the derivative is taken of [rad]."""
    return -y if s[k + 7] != 0.0 else error


@inlined
def servo_sample(setpoint: float, q: float, total: float, before: float, s: Table, k: int) -> Vec:
    """Motor voltage [V], new sum and new d of one joint for one sample."""
    y = measured_position(q, s, k)
    error = setpoint - y
    d_now = d_signal(error, y, s, k)
    u, total = pid_law(error, d_now, before, total, s[k], s[k + 1], s[k + 2], s[k + 9])
    u = min(max(u, -s[k + 3]), s[k + 3])
    # the converter's highest code is one step short of its lowest, as in two's complement
    u = quantised(u, s[k + 5])
    if s[k + 5] > 0.0:
        u = min(u, s[k + 3] - s[k + 5])
    return u * s[k + 6], total, d_now


@inlined
def delayed(j: int, u: float, memory: Table, s: Table) -> float:
    """The voltage of joint j that acts now: the oldest held back, whose place u takes [V]."""
    delay = int(s[j * SERVO_WIDTH + 8])
    if delay == 0:
        return u
    k = 3 * MEMORY_WIDTH + j * delay
    oldest = memory[k]
    for i in range(k, k + delay - 1):
        memory[i] = memory[i + 1]
    memory[k + delay - 1] = u
    return oldest


@inlined
def servo_at_rest(setpoint: float, q: float, s: Table, k: int) -> Vec:
    """The memory (sum, d) with which a joint's servo starts: no sum, no derivative to come."""
    y = measured_position(q, s, k)
    return 0.0, d_signal(setpoint - y, y, s, k)
