# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One sample of computed torque, scheduled PID and velocity loops, as scalar code that is compiled ahead.

A controller's constants are one flat table and its state is a few numbers that a sample takes and gives back. The same
code runs as plain Python where it was not compiled before: a controller never waits for a compiler.
"""

from collections.abc import Sequence
from math import cos, sin

import numpy as np

from puma_sim_core.arm.rigid_body import Lumps
from puma_sim_core.dynamics.rigid import rigid_body
from puma_sim_core.jit import Table, Vec, compiled, compiled_ahead, inlined, written
from puma_sim_core.servo.pid import pid_law

_BODY = len(Lumps._fields)
#: where the constants of `computed_torque` stand, behind those of the body
_PER_TORQUE, _EMF, _GAINS, _SAMPLE = _BODY, _BODY + 3, _BODY + 6, _BODY + 15
#: where those of a schedule stand: where each of its nine entries begins, how many columns it has, and the angles
_STARTS, _WIDTHS, _ANGLES = 2, 11, 20
#: (c) -> the constants of the rigid body, the first of a table
_body_of = written("body_of", "c", [f"return ({', '.join(f'c[{k}]' for k in range(_BODY))})"], {})


def packed(values: Sequence[float]) -> Table:
    """Constants as the laws take them: an array where they have been compiled ahead, otherwise a list."""
    numbers = [float(value) for value in values]
    if not compiled_ahead("trials"):
        return numbers
    # what is compiled is loaded here, not at the first sample
    compile_laws()
    return np.array(numbers)


@inlined
def reference_at(piece: Vec, u: float, T: float, lead: float) -> Vec:
    """Position [rad], velocity [rad/s] and acceleration [rad/s^2] of a path at the share u of a period T [s].

    piece : p0, p1 - p0, p2 - p1, the acceleration, and of the lead its first share, what that gains, and its slope;
    lead [s]. The path is that of `puma_sim_core.control.reference`.
    """
    p0, first, second, acceleration, before, gained, slope = piece
    # in a form that gives p0 exactly where all three are equal
    position = p0 + 0.5 * (first * (1.0 + u * (2.0 - u)) + second * u * u)
    velocity = ((1.0 - u) * first + u * second) / T
    c = lead * (before + u * gained)
    # the spline of a parabola lies T^2/8 of its second derivative beside it: c T / 12
    return (
        position + c * velocity + (0.5 * c - T / 12.0) * c * acceleration,
        velocity + c * acceleration + slope * (velocity + (c - T / 12.0) * acceleration),
        acceleration,
    )


@inlined
def _filtered(known: float, share: float, q: float, before: float, h: float) -> float:
    """Velocity [rad/s] by differences of positions, through a filter of first order."""
    return known + share * ((q - before) / h - known)


@inlined
def inverse_terms(q: Vec, v: Vec, body: Vec) -> Vec:
    """M = D + Ia row by row from the diagonal [kg.m^2], and b = -C(q, v) - G(q) [N.m] (equation 4.1)."""
    u = q[1] + q[2]
    return rigid_body(v[0], v[1], v[2], 0.0, 0.0, 0.0, (sin(q[1]), cos(q[1]), sin(u), cos(u)), body)


@inlined
def _acceleration(j: int, own: float, error: float, rate: float, total: float, wanted: float, c: Table) -> float:
    """What a joint is asked for [rad/s^2]: that of the reference, and what holds it with three poles."""
    at = _GAINS + 3 * j
    damping = c[at] - own
    if damping < 0.0:
        damping = 0.0
    return wanted + damping * rate + c[at + 1] * (3.0 * error + c[at + 2] * total)


@inlined
def _limited(u: float, limit: float, error: float, before: float, after: float) -> Vec:
    """Voltage within its limit, and the sum: where it is at its limit an error that drives it further is not added."""
    if u > limit:
        return limit, after if error < 0.0 else before
    if u < -limit:
        return -limit, after if error > 0.0 else before
    return u, after


@compiled
def computed_torque(c: Table, q: Vec, known: Vec, u: float, pieces: Vec) -> tuple[Vec, Vec]:
    """Volts (3,), and what the next sample must know.

    c : `torque_table`; q (3,) : measured [rad]; known (9,) : measured before [rad], filtered
    velocity [rad/s] and sum of the errors [rad.s] of each joint; u, pieces (21,) : of the reference, see
    `reference_at`. The law is that of `puma_sim_core.control.computed_torque`.
    """
    h, share, limit = c[_SAMPLE], c[_SAMPLE + 1], c[_SAMPLE + 2]
    amplifier, of_reference = c[_SAMPLE + 3], c[_SAMPLE + 4] != 0.0
    p1, p2, p3, v1, v2, v3, s1, s2, s3 = known
    T, lead = c[_SAMPLE + 5], c[_SAMPLE + 6]
    r1, rd1, rdd1 = reference_at(pieces[:7], u, T, lead)
    r2, rd2, rdd2 = reference_at(pieces[7:14], u, T, lead)
    r3, rd3, rdd3 = reference_at(pieces[14:], u, T, lead)
    q1, q2, q3 = q
    v1 = _filtered(v1, share, q1, p1, h)
    v2 = _filtered(v2, share, q2, p2, h)
    v3 = _filtered(v3, share, q3, p3, h)
    m11, m12, m13, m22, m23, m33, b1, b2, b3 = inverse_terms(q, (v1, v2, v3), _body_of(c))
    k1, k2, k3 = c[_PER_TORQUE], c[_PER_TORQUE + 1], c[_PER_TORQUE + 2]
    emf1, emf2, emf3 = c[_EMF], c[_EMF + 1], c[_EMF + 2]
    w1, w2, w3 = v1, v2, v3
    own1, own2, own3 = 0.0, 0.0, 0.0
    if of_reference:
        w1, w2, w3 = rd1, rd2, rd3
        own1, own2, own3 = emf1 / (k1 * m11), emf2 / (k2 * m22), emf3 / (k3 * m33)
    e1, e2, e3 = r1 - q1, r2 - q2, r3 - q3
    n1, n2, n3 = s1 + h * e1, s2 + h * e2, s3 + h * e3
    a1 = _acceleration(0, own1, e1, rd1 - v1, n1, rdd1, c)
    a2 = _acceleration(1, own2, e2, rd2 - v2, n2, rdd2, c)
    a3 = _acceleration(2, own3, e3, rd3 - v3, n3, rdd3, c)
    u1, n1 = _limited(k1 * (m11 * a1 + m12 * a2 + m13 * a3 - b1) + emf1 * w1, limit, e1, s1, n1)
    u2, n2 = _limited(k2 * (m12 * a1 + m22 * a2 + m23 * a3 - b2) + emf2 * w2, limit, e2, s2, n2)
    u3, n3 = _limited(k3 * (m13 * a1 + m23 * a2 + m33 * a3 - b3) + emf3 * w3, limit, e3, s3, n3)
    return (u1 / amplifier, u2 / amplifier, u3 / amplifier), (q1, q2, q3, v1, v2, v3, n1, n2, n3)


@inlined
def _loops(j: int, c: Table, q: float, v: float, total: float, r: float, rd: float) -> Vec:
    """Voltage of a joint and its sum [rad/s]."""
    return pid_law(rd + c[3 * j] * (r - q) - v, 0.0, 0.0, total, c[3 * j + 1], c[3 * j + 2], 0.0, c[11])


@compiled
def velocity_loops(c: Table, q: Vec, known: Vec, u: float, pieces: Vec) -> tuple[Vec, Vec]:
    """Volts (3,), and what the next sample must know.

    c : of each joint Kp [1/s], Kv [V.s/rad] and h/Tv, then h [s], the share of the velocity's filter, the limit [V],
    and period and lead [s] of the reference; q (3,) : measured [rad]; known (9,) : measured before [rad], filtered
    velocity [rad/s] and sum [rad/s] of each joint; u, pieces (21,) : see `reference_at`. The law is that of
    `puma_sim_core.control.velocity_loop`.
    """
    h, share, T, lead = c[9], c[10], c[12], c[13]
    p1, p2, p3, v1, v2, v3, s1, s2, s3 = known
    q1, q2, q3 = q
    r1, rd1, _ = reference_at(pieces[:7], u, T, lead)
    r2, rd2, _ = reference_at(pieces[7:14], u, T, lead)
    r3, rd3, _ = reference_at(pieces[14:], u, T, lead)
    v1 = _filtered(v1, share, q1, p1, h)
    v2 = _filtered(v2, share, q2, p2, h)
    v3 = _filtered(v3, share, q3, p3, h)
    u1, s1 = _loops(0, c, q1, v1, s1, r1, rd1)
    u2, s2 = _loops(1, c, q2, v2, s2, r2, rd2)
    u3, s3 = _loops(2, c, q3, v3, s3, r3, rd3)
    return (u1, u2, u3), (q1, q2, q3, v1, v2, v3, s1, s2, s3)


def torque_table(
    body: Sequence[float],
    per_torque: Sequence[float],
    back_emf: Sequence[float],
    gains: Sequence[Sequence[float]],
    sample: Sequence[float],
) -> list[float]:
    """The constants of computed torque in a row.

    body : `Lumps`; per_torque [V/(N.m)], back_emf [V.s/rad] (3,); gains : of each joint those of the error's rate
    [1/s], of the error [1/s^2], and of its sum beside that [1/s]; sample : period [s], share of the velocity's filter,
    limit [V], gain of the amplifier, not 0 where the back-EMF is that of the reference, and period and lead [s] of the
    reference.
    """
    return [*body, *per_torque, *back_emf, *(gain for joint in gains for gain in joint), *sample]


@inlined
def _place(c: Table, first: int, count: int, q: float) -> tuple[int, float]:
    """The interval of `count` increasing angles, from `first` on, that q [rad] lies in, and the share of it, 0 to 1."""
    i = first
    while i < first + count - 2 and q >= c[i + 1]:
        i += 1
    share = (q - c[i]) / (c[i + 1] - c[i])
    return i - first, 0.0 if share < 0.0 else 1.0 if share > 1.0 else share


@inlined
def _gain(c: Table, entry: int, place: tuple[int, int], shares: Vec) -> float:
    """Entry 0 to 8 of a schedule: a number that holds everywhere, or linear between four points of its table."""
    start, columns = int(c[_STARTS + entry]), int(c[_WIDTHS + entry])
    if columns == 0:
        return c[start]
    low = start + place[0] * columns + place[1]
    high = low + columns
    left = c[low] + shares[1] * (c[low + 1] - c[low])
    return left + shares[0] * (c[high] + shares[1] * (c[high + 1] - c[high]) - left)


@inlined
def scheduled_gains(c: Table, q2: float, q3: float) -> Vec:
    """(gain, integral_time, derivative_time) of each joint, joint by joint, at a pose [rad]; c : `schedule_table`."""
    rows, columns = int(c[0]), int(c[1])
    i, a = _place(c, _ANGLES, rows, q2)
    k, b = _place(c, _ANGLES + rows, columns, q3)
    at, share = (i, k), (a, b)
    return (
        _gain(c, 0, at, share),
        _gain(c, 1, at, share),
        _gain(c, 2, at, share),
        _gain(c, 3, at, share),
        _gain(c, 4, at, share),
        _gain(c, 5, at, share),
        _gain(c, 6, at, share),
        _gain(c, 7, at, share),
        _gain(c, 8, at, share),
    )


@compiled
def scheduled_pid(c: Table, how: Vec, q: Vec, setpoint: Vec, known: Vec) -> tuple[Vec, Vec]:
    """Volts (3,), and what the next sample must know.

    c : `schedule_table`; how : period [s], limit [V], and not 0 where the derivative is that of the measurement; q,
    setpoint (3,) [rad]; known (9,) : of each joint what was differentiated before [rad], the sum [rad], and the gain
    [V/rad] that it was made with, 0 at a first sample. The law is that of `puma_sim_core.control.scheduled`.
    """
    h, limit, of_measurement = how
    b1, b2, b3, s1, s2, s3, k1, k2, k3 = known
    g1, i1, d1, g2, i2, d2, g3, i3, d3 = scheduled_gains(c, q[1], q[2])
    e1, e2, e3 = setpoint[0] - q[0], setpoint[1] - q[1], setpoint[2] - q[2]
    n1, n2, n3 = e1, e2, e3
    if of_measurement != 0.0:
        n1, n2, n3 = -q[0], -q[1], -q[2]
    if k1 == 0.0:
        b1, b2, b3, k1, k2, k3 = n1, n2, n3, g1, g2, g3
    u1, s1 = pid_law(e1, n1, b1, s1 * (k1 / g1), g1, h / i1, d1 / h, limit)
    u2, s2 = pid_law(e2, n2, b2, s2 * (k2 / g2), g2, h / i2, d2 / h, limit)
    u3, s3 = pid_law(e3, n3, b3, s3 * (k3 / g3), g3, h / i3, d3 / h, limit)
    return (u1, u2, u3), (n1, n2, n3, s1, s2, s3, g1, g2, g3)


def schedule_table(
    q2: Sequence[float], q3: Sequence[float], entries: Sequence[float | Sequence[Sequence[float]]]
) -> list[float]:
    """The numbers of a schedule in a row: the angles of its tables [rad], and nine entries, joint by joint, each a
    number or rows for each q2 of values for each q3."""
    values: list[float] = []
    starts: list[float] = []
    widths: list[float] = []
    for entry in entries:
        starts.append(_ANGLES + len(q2) + len(q3) + len(values))
        if isinstance(entry, float):
            widths.append(0)
            values.append(entry)
        else:
            widths.append(len(q3))
            values += [value for row in entry for value in row]
    return [len(q2), len(q3), *starts, *widths, *q2, *q3, *values]


def compile_laws() -> None:
    """Call the laws once as a controller does that finds them compiled."""
    table, three, nine = np.zeros(_SAMPLE + 7), (0.0,) * 3, (0.0,) * 9
    computed_torque(table, three, nine, 0.0, (0.0,) * 21)
    scheduled_pid(table, three, three, three, nine)
    velocity_loops(table, three, nine, 0.0, (0.0,) * 21)
