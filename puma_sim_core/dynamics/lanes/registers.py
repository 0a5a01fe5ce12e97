# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Several runs side by side in the lanes of the processor's vector registers.

The same step as that of one arm, inside a loop over lanes that the compiler turns into vector
instructions. That needs a sine and cosine without calls or branches: polynomials on
[-pi/4, pi/4] behind a reduction by pi/2 in three parts. They are within 1 ulp of the C library's
for angles up to 1e5 rad, so that a run in a lane agrees with the same run alone to rounding, not
bit for bit. What a lane gives does not depend on its neighbours.
"""

from collections.abc import Callable
from math import floor
from typing import Any

from puma_sim_core.dynamics.laws import UNBENT
from puma_sim_core.dynamics.rigid import build_arm
from puma_sim_core.dynamics.types import FREE, NO_SLIP, Model
from puma_sim_core.jit import Table, Vec, compiled, inlined, written

#: runs side by side: two registers of AVX2, one of AVX-512
LANES = 8
#: numbers of one lane: state 9, voltages 3, body 20, drive 15
LANE_NUMBERS = 47

_TWO_OVER_PI = 0.6366197723675814
#: pi/2 as a sum; the first two have 33 bits, so that their products with a quarter count are exact
_P1, _P2, _P3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21


@inlined
def one_of_two(first: bool, a: float, b: float) -> float:
    """The first of two numbers, or the second."""
    return a if first else b


def build_trigonometry(
    floor: Callable[..., Any], one_of_two: Callable[..., Any]
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Sine and cosine by polynomials, free of branches where the two functions are, and what is made of them in place
    of `rigid.library_trigonometry`.

    The coefficients interpolate (sin r / r - 1) / z and (cos r - 1 + z/2) / z^2 at the Chebyshev
    points of z = r^2 in [0, (pi/4)^2]; relative errors 1.3e-17 and 5e-19 before rounding.
    """

    @inlined
    def polynomial_sin_cos(x: Table) -> tuple[Table, Table]:
        n = floor(x * _TWO_OVER_PI + 0.5)
        r = ((x - n * _P1) - n * _P2) - n * _P3
        z = r * r
        s = z * (2.7557316101617874e-06 + z * (-2.505113165023518e-08 + z * 1.5918115263265974e-10))
        s = -0.16666666666666666 + z * (0.008333333333330948 + z * (-0.00019841269836756774 + s))
        s = r + r * z * s
        c = z * (-2.7557317271145144e-07 + z * (2.087614614655861e-09 - z * 1.1382623647474604e-11))
        c = -0.0013888888888887398 + z * (2.480158729876456e-05 + c)
        c = 1.0 - (0.5 * z - z * z * (0.041666666666666664 + z * c))
        quarter = n - 4.0 * floor(0.25 * n)
        odd = abs(abs(quarter - 2.0) - 1.0) < 0.5  # 1 or 3
        sine = one_of_two(odd, c, s)
        cosine = one_of_two(odd, s, c)
        sine = one_of_two(quarter >= 2.0, -sine, sine)
        cosine = one_of_two(abs(quarter - 1.5) < 1.0, -cosine, cosine)  # 1 or 2
        return sine, cosine

    @inlined
    def trigonometry(q2: Table, q3: Table) -> Vec:
        s2, c2 = polynomial_sin_cos(q2)
        su, cu = polynomial_sin_cos(q2 + q3)
        return s2, c2, su, cu

    return polynomial_sin_cos, trigonometry


polynomial_sin_cos, polynomial_trigonometry = build_trigonometry(floor, one_of_two)
_, lane_step = build_arm(polynomial_trigonometry)


def in_lane(first: int, count: int) -> list[str]:
    """Source of as many numbers of lane m of the flat array a."""
    return [f"a[{LANES * number} + m]" for number in range(first, first + count)]


def lane_reader(first: int, count: int) -> Callable[..., Any]:
    """(a, m) -> as many numbers of lane m."""
    return written("read", "a, m", [f"return ({', '.join(in_lane(first, count))})"], {})


def lane_writer(first: int, count: int) -> Callable[..., Any]:
    """(a, m, y) puts as many numbers in lane m."""
    return written("write", "a, m, y", [f"{place} = y[{k}]" for k, place in enumerate(in_lane(first, count))], {})


state_of, put_state = lane_reader(0, 9), lane_writer(0, 9)
volts_of, put_volts = lane_reader(9, 3), lane_writer(9, 3)
body_of, drive_of = lane_reader(12, 20), lane_reader(32, 15)


@inlined
def step_lanes(a: Table, h: float, p: Table) -> None:
    """One step of all lanes; a: flat, number k of lane l at k * LANES + l."""
    for m in range(LANES):
        model = Model(body_of(a, m), drive_of(a, m), 0)
        y, _ = lane_step(state_of(a, m), UNBENT, volts_of(a, m), h, model, p, FREE, NO_SLIP)
        put_state(a, m, y)


@compiled
def run_lanes(a: Table, volts: Table, which: Table, counts: Table, steps: Table, p: Table, out: Table) -> None:
    """One group of LANES runs without effects or constraints.

    a : flat, LANE_NUMBERS * LANES, the lanes' numbers, moved on; volts (k, n, 3) [V], terminal
    voltages; which (LANES,): the row of `volts` for each lane; counts, steps (n,) as
    `runs.run_voltages`; out (LANES, n + 1, 9).
    """
    for m in range(LANES):
        for k in range(9):
            out[m, 0, k] = a[k * LANES + m]
    for r in range(len(counts)):
        for m in range(LANES):
            for k in range(3):
                a[(9 + k) * LANES + m] = volts[which[m], r, k]
        for _ in range(counts[r]):
            step_lanes(a, steps[r], p)
        for m in range(LANES):
            for k in range(9):
                out[m, r + 1, k] = a[k * LANES + m]
