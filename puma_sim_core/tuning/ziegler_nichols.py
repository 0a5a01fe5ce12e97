# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Ultimate gain and period of a joint, and the settings of table 7.2 (section 7.6.1).

One joint moves, the others are locked. A proportional controller samples its position; the gain
at which the oscillation sustains itself is the ultimate gain, found in two ways:

`ultimate_by_eigenvalues` : the joint linearised at its pose is a system of third order in
    (q, qd, i), with the stiffness of gravity in it (see `linear`). With the voltage held over each
    sample it is a linear map; the closed loop, its delay included, is stable as long as the
    eigenvalues of its own map lie within the unit circle.
`ultimate_by_simulation` : the simulator itself, nonlinear and with the effects of its plant, under
    its digital servo, from a small disturbance of the equilibrium: does the oscillation grow?

Below the ultimate gain there may be another bound: an arm above its shoulder needs a least gain to
stand up at all. Where no gain keeps the joint stable, or none makes it oscillate below the limit,
there is no ultimate gain, and a `TuningError` says so.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, inf, isfinite, log2, pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.rigid_body import gravity_torque
from puma_sim_core.checks import check_choice, check_numbers, check_positive, check_whole
from puma_sim_core.control.linear import linearised, proportional_loop, radius, sampled
from puma_sim_core.errors import LimitError, NonFiniteStateError, ParameterError, TuningError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

#: default of the greatest gain that is looked at [V/rad]
GREATEST_GAIN = 1e6
#: the search starts this much below the greatest gain
_SPAN = 1e9
_GRID = 280
_COARSE = 90
#: longest delay [samples]: the size of the maps grows with it
GREATEST_DELAY = 100
#: ratio of the gains that a simulation tries first, and the periods that it then looks at
_STRIDE = 0.9
_PERIODS = 60.0

#: table 7.2: Kg / Kmax, Ti / Tp, Td / Tp
SETTINGS = {"P": (0.5, inf, 0.0), "PI": (0.45, 1.0 / 1.2, 0.0), "PID": (0.6, 0.5, 0.125)}


@dataclass(frozen=True)
class Ultimate:
    """What the ultimate-sensitivity method measures.

    gain : Kmax [V/rad]; period : Tp [s]; least_gain : the gain [V/rad] below which the joint
    falls over, 0.0 where it stands by itself (None: not looked for).
    """

    gain: float
    period: float
    least_gain: float | None = None


def settings(ultimate: Ultimate, method: str = "PID") -> PidGains:
    """Table 7.2; method : "P", "PI" or "PID". Raises ParameterError for another."""
    check_choice(method, "method", SETTINGS, "Ziegler-Nichols settings")
    kg, ti, td = SETTINGS[method]
    return PidGains(kg * ultimate.gain, ti * ultimate.period, td * ultimate.period)


@dataclass(frozen=True)
class Loop:
    """One joint under sampled control, the others locked.

    Parameters
    ----------
    plant : the arm and its effects.
    joint : 1, 2 or 3.
    pose : (3,) [rad], at which all joints stand.
    period : time between samples [s].
    delay : samples by which a voltage acts late.

    Raises
    ------
    ParameterError : a joint, period or delay that cannot be.
    LimitError : a pose outside the ranges of the joints.
    """

    plant: Plant
    joint: int
    pose: Sequence[float]
    period: float = SERVO_PERIOD
    delay: int = 0

    def __post_init__(self) -> None:
        check_choice(self.joint, "joint", (1, 2, 3))
        object.__setattr__(self, "pose", check_numbers(self.pose, "pose"))
        for j, (q, (low, high)) in enumerate(zip(self.pose, self.plant.arm.joint_ranges), 1):
            if not low <= q <= high:
                expected = f"{np.degrees(low):.4g} to {np.degrees(high):.4g} deg"
                raise LimitError(f"joint {j} at {np.degrees(q):.6g} deg", where="pose", expected=expected)
        if not (isfinite(self.period) and 0.0 < self.period <= 1.0):
            raise ParameterError(f"period {self.period!r} s", expected="more than 0 and at most 1 s")
        check_whole(self.delay, "delay", 0, GREATEST_DELAY)

    def equilibrium(self) -> tuple[float, float]:
        """Voltage [V] and current [A] that hold the joint at its pose."""
        j = self.joint - 1
        current = gravity_torque(self.pose, self.plant.loaded_arm)[j] / self.plant.torque_per_ampere[j]
        return current * self.plant.arm.motors[j].resistance, current


def ultimate_by_eigenvalues(loop: Loop, *, limit: float = GREATEST_GAIN) -> Ultimate:
    """Ultimate gain and period of the linearised joint, to about nine digits.

    limit : greatest gain looked at [V/rad]. Dry friction, current limits and stops of the plant
    are not in it (`linear.is_linear`); viscous friction and loads are.

    Raises
    ------
    TuningError : no gain below the limit keeps the joint stable, or none makes it oscillate.
    """
    found = _search(loop.plant, loop.joint, np.array(loop.pose), loop.period, loop.delay, limit, _GRID)
    gain, period, least = (float(values) for values in found)
    if np.isnan(least):
        raise _no_stable_gain(loop, limit)
    if np.isnan(gain):
        raise _no_ultimate_gain(loop, limit)
    return Ultimate(gain, period, least)


def ultimate_map(
    plant: Plant,
    joint: int,
    poses: ArrayLike,
    *,
    period: float = SERVO_PERIOD,
    delay: int = 0,
    limit: float = GREATEST_GAIN,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`ultimate_by_eigenvalues` at many poses (..., 3) [rad].

    Returns
    -------
    (Kmax [V/rad], Tp [s], least gain [V/rad]), each (...). NaN where there is none: all three
    where no gain keeps the joint stable, the first two where none makes it oscillate.

    Raises
    ------
    As `Loop`; the ranges of the joints are not looked at.
    """
    poses = np.asarray(poses, dtype=float)
    Loop(plant, joint, np.clip(0.0, *np.transpose(plant.arm.joint_ranges)), period, delay)
    return _search(plant, joint, poses, period, delay, limit, _COARSE)


def _search(
    plant: Plant, joint: int, poses: np.ndarray, period: float, delay: int, limit: float, points: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, period and least gain at poses (..., 3); NaN where there is none."""
    check_positive(limit, "limit", "V/rad")
    f, g = sampled(*linearised(plant, poses, (joint,)), period)

    def stable(gains: ArrayLike) -> np.ndarray:
        return radius(proportional_loop(f, g, gains, delay)) < 1.0

    # free of gravity the joint is at the bound of stability without a gain, and inside with one
    grid = np.geomspace(limit / _SPAN, limit, points)
    inside = np.stack([stable(k) for k in grid], axis=-1)
    first = np.argmax(inside, axis=-1)
    some = inside.any(axis=-1)
    behind = ~inside & (np.arange(points) > first[..., None])
    last = np.argmax(behind, axis=-1)
    ends = some & behind.any(axis=-1)
    gain = _bisected(stable, grid[last - 1], grid[last])
    least = _bisected(lambda k: ~stable(k), grid[first - 1], grid[first])
    z = np.linalg.eigvals(proportional_loop(f, g, gain, delay))
    outermost = np.take_along_axis(z, np.argmax(np.abs(z), -1)[..., None], -1)[..., 0]
    angle = np.abs(np.angle(outermost))
    with np.errstate(divide="ignore"):
        return (
            np.where(ends, gain, np.nan),
            np.where(ends, 2.0 * pi * period / angle, np.nan),
            np.where(some, np.where(first == 0, 0.0, least), np.nan),
        )


def _bisected(is_below: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The gains between low and high (...) at which `is_below` ends, to 1e-10."""
    ratio = float(np.max(np.abs(np.log(high / low))))
    for _ in range(ceil(log2(max(ratio, 1e-9) / 1e-10))):
        middle = np.sqrt(low * high)
        below = is_below(middle)
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.sqrt(low * high)


def ultimate_by_simulation(
    loop: Loop, *, limit: float = GREATEST_GAIN, amplitude: float = 1e-4, accuracy: float = 1e-3
) -> Ultimate:
    """Ultimate gain and period as an experimenter finds them, on the nonlinear simulator.

    The joint stands at its pose, held against gravity, but `amplitude` [rad] beside it. Gains are
    taken from the limit down to the first at which the oscillation dies out, and then bisected.
    accuracy : relative, of the gain. No voltage limit but that of the plant's effects.

    Raises
    ------
    TuningError : as `ultimate_by_eigenvalues`.
    """
    check_positive(limit, "limit", "V/rad")
    held = [Constraint("hold")] * 3
    held[loop.joint - 1] = Constraint()
    simulator = Simulator(loop.plant, constraints=held)
    samples = most = ceil(max(400.0, 1.0 / loop.period))

    def grows(gain: float) -> bool:
        return _grows(_response(simulator, loop, gain, amplitude, samples), samples, amplitude)

    high = limit
    if not grows(high):
        raise _no_ultimate_gain(loop, limit)
    low = _STRIDE * high
    while grows(low):
        low, high = _STRIDE * low, low
        if low < limit / _SPAN:
            raise _no_stable_gain(loop, limit)
    while True:
        period = _period(_response(simulator, loop, high, amplitude, samples), loop.period)
        # near the bound growth is slow: as many periods as make it plain
        enough = 2 * samples if period is None else ceil(_PERIODS * period / loop.period)
        if enough > samples:
            if period is None and enough > 64 * most:
                expected = "an oscillation at the bound of stability"
                raise TuningError("it falls without oscillating", where=_place(loop), expected=expected)
            samples = enough
            while grows(low) and low > limit / _SPAN:
                low *= _STRIDE
            while not grows(high) and high < limit:
                high /= _STRIDE
        elif high / low <= 1.0 + accuracy:
            return Ultimate(float((low * high) ** 0.5), period or inf)
        else:
            middle = (low * high) ** 0.5
            low, high = (low, middle) if grows(middle) else (middle, high)


def _response(simulator: Simulator, loop: Loop, gain: float, amplitude: float, samples: int) -> np.ndarray:
    """Deviation from the pose [rad] at each sample, up to where it is no longer small."""
    j = loop.joint - 1
    voltage, current = loop.equilibrium()
    start, setpoint = list(loop.pose), list(loop.pose)
    start[j] += amplitude
    setpoint[j] += voltage / gain
    volts, amperes = [0.0] * 3, [0.0] * 3
    volts[j], amperes[j] = voltage, current
    first, second, third = (PidGains(gain if k == j else 0.0) for k in range(3))
    simulator.reset(start, current=amperes)
    servo = ServoConfig((first, second, third), delay_samples=loop.delay)
    try:
        run = simulator.run_servo(
            [setpoint], servo, period=samples * loop.period, samples=samples, voltage_limit=inf, held_voltage=volts
        )
    except NonFiniteStateError:
        return np.array([amplitude, inf])
    position: Any = run.position
    deviation = position[:, j] - loop.pose[j]
    large = np.flatnonzero(np.abs(deviation) > 100.0 * amplitude)
    return deviation[: large[0] + 1] if large.size else deviation


def _grows(deviation: np.ndarray, samples: int, amplitude: float) -> bool:
    """Whether the oscillation is larger at the end than before: smooth windows make the answer
    free of where in its period it is cut off."""
    if len(deviation) <= samples:
        return True
    quarter = len(deviation) // 4
    window = np.hanning(quarter)
    end = deviation[-quarter:] * window
    before = deviation[-2 * quarter : -quarter] * window
    # what has died out leaves rounding, which need not shrink
    return bool(np.abs(end).max() > 1e-3 * amplitude and end @ end > before @ before)


def _period(deviation: np.ndarray, step: float) -> float | None:
    """Period [s] from the upward zero crossings of the last half, None for fewer than three."""
    deviation = deviation[len(deviation) // 2 :]
    if not np.isfinite(deviation).all():
        return None
    up = np.flatnonzero((deviation[:-1] < 0.0) & (deviation[1:] >= 0.0))
    if len(up) < 3:
        return None
    at = up - deviation[up] / (deviation[up + 1] - deviation[up])
    return float((at[-1] - at[0]) / (len(at) - 1) * step)


def _no_ultimate_gain(loop: Loop, limit: float) -> TuningError:
    return TuningError(
        f"no ultimate gain below {limit:g} V/rad: the oscillation dies out up to it",
        where=_place(loop),
        expected="a greater limit, or a longer period or delay",
    )


def _no_stable_gain(loop: Loop, limit: float) -> TuningError:
    return TuningError(
        f"no proportional gain below {limit:g} V/rad keeps the joint stable",
        where=_place(loop),
        expected="a shorter period or delay, or a pose that is easier to hold",
    )


def _place(loop: Loop) -> str:
    pose = ", ".join(f"{q:.4g}" for q in loop.pose)
    return f"joint {loop.joint} at ({pose}) rad, every {loop.period * 1e3:.4g} ms, {loop.delay} samples of delay"
