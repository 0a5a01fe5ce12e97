# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Equations 4.9 to 4.47 term by term, each misprint of them a switch.

Every function takes the symbols at a pose and the set of misprints ("slips") to put in; without
slips it is the corrected equation in the thesis's own order of terms.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

from puma_sim_core.arm.arm import ArmParameters


def symbols(q, arm: ArmParameters) -> SimpleNamespace:
    """The thesis's symbols at a pose: s2, c2, s3, c3, su, cu (u = q2 + q3), m, x, y, z, k."""
    at = SimpleNamespace(
        a2=arm.a2,
        a3=arm.a3,
        d3=arm.d3,
        g=arm.gravity,
        s2=math.sin(q[1]),
        c2=math.cos(q[1]),
        s3=math.sin(q[2]),
        c3=math.cos(q[2]),
        su=math.sin(q[1] + q[2]),
        cu=math.cos(q[1] + q[2]),
        c22=math.cos(2 * q[1]),
    )
    for i, link in enumerate(arm.links, start=1):
        setattr(at, f"m{i}", link.mass)
        for axis, value in zip("xyz", link.centre):
            setattr(at, f"{axis}{i}", value)
        for axis, value in zip("xyz", link.gyration_squared):
            setattr(at, f"k{i}{axis}{axis}", value)
    return at


def d11(s, slips=()):
    """Equation 4.9."""
    k1 = s.k1zz if "k1zz" in slips else s.k1yy
    side = s.d3 if "d3" in slips else s.d3**2
    product = 0.0 if "no y2" in slips else -2 * s.a2 * s.y2 * s.s2 * s.c2
    return (
        s.m1 * k1
        + s.m2 * (s.k2xx * s.s2**2 + s.k2yy * s.c2**2 + s.a2**2 * s.c2**2 + 2 * s.a2 * s.x2 * s.c2**2 + product)
        + s.m3
        * (
            s.k3xx * s.su**2
            + s.k3zz * s.cu**2
            + side
            + s.a2**2 * s.c2**2
            + s.a3**2 * s.cu**2
            + 2 * s.a2 * s.a3 * s.c2 * s.cu
            + 2 * s.x3 * (s.a2 * s.c2 * s.cu + s.a3 * s.cu**2)
            + 2 * s.y3 * s.d3
            + 2 * s.z3 * (s.a3 * s.cu * s.su + s.a2 * s.c2 * s.su)
        )
    )


def d22(s, slips=()):
    """Equation 4.13."""
    upper = s.a2 if "a2" in slips else s.a2**2
    fore = s.a3 if "a3" in slips else s.a3**2
    k3 = s.k3zz if "k3zz" in slips else s.k3yy
    return s.m2 * (s.k2zz + upper + 2 * s.a2 * s.x2) + s.m3 * (
        (2 * s.a2 * s.a3 + 2 * s.a2 * s.x3) * s.c3 + 2 * s.a2 * s.z3 * s.s3 + k3 + s.a2**2 + fore + 2 * s.a3 * s.x3
    )


def d23(s, slips=()):
    """Equation 4.14."""
    k3 = s.k3zz if "k3zz" in slips else s.k3yy
    return s.m3 * ((s.a2 * s.x3 + s.a2 * s.a3) * s.c3 + s.a2 * s.z3 * s.s3 + 2 * s.a3 * s.x3 + s.a3**2 + k3)


def d33(s, slips=()):
    """Equation 4.17."""
    k3 = s.k3zz if "k3zz" in slips else s.k3yy
    return s.m3 * (k3 + s.a3**2 + 2 * s.a3 * s.x3)


def c112(s, slips=()):
    """Equation 4.19."""
    square2 = s.a2 if "a2" in slips else s.a2**2
    first = s.s2 * s.c3 if "S2C3" in slips else s.c3 * s.s3
    k3z = s.k3xx if "no k3zz" in slips else s.k3zz
    sine = s.su if "a2a3S23" in slips else s.s3
    square3 = s.a3 if "2a3" in slips else s.a3**2
    last = s.c2 * s.s3 if "C2S3" in slips else s.c3 * s.s3
    triple = s.s2 * s.s3 * s.su
    return s.m2 * ((s.k2xx - s.k2yy - square2 - 2 * s.a2 * s.x2) * s.c2 * s.s2 - s.a2 * s.y2 * s.c22) + s.m3 * (
        s.k3xx * (s.c2 * s.s2 + first - 2 * triple)
        + k3z * (2 * triple - s.c2 * s.s2 - s.c3 * s.s3)
        + s.x3
        * (-2 * s.a2 * s.c2 * s.su + 4 * s.a3 * triple + s.a2 * s.s3 - 2 * s.a3 * s.c2 * s.s2 - 2 * s.a3 * s.c3 * s.s3)
        + s.z3 * (s.a2 * s.c2 * s.cu - s.a2 * s.s2 * s.su + 2 * s.a3 * s.cu**2 - s.a3)
        + s.a2 * s.a3 * sine
        - 2 * s.a2 * s.a3 * s.c2 * s.su
        - s.a2**2 * s.c2 * s.s2
        + 2 * square3 * triple
        - s.a3**2 * (s.c2 * s.s2 + last)
    )


def c113(s, slips=()):
    """Equation 4.20."""
    k3 = s.k3yy if "k3yy" in slips else s.k3zz
    square3 = s.a3 if "2a3" in slips else s.a3**2
    triple = s.s2 * s.s3 * s.su
    return s.m3 * (
        s.k3xx * (s.c2 * s.s2 + s.c3 * s.s3 - 2 * triple)
        + k3 * (2 * triple - s.c2 * s.s2 - s.s3 * s.c3)
        + s.x3 * (4 * s.a3 * triple - 2 * s.a3 * s.c2 * s.s2 - 2 * s.a3 * s.c3 * s.s3 - s.a2 * s.c2 * s.su)
        + s.z3 * (2 * s.a3 * s.cu**2 + s.a2 * s.c2 * s.cu - s.a3)
        + 2 * square3 * triple
        - s.a2 * s.a3 * s.c2 * s.su
        - s.a3**2 * s.c2 * s.s2
        - s.a3**2 * s.c3 * s.s3
    )


def c122(s, slips=()):
    """Equation 4.22."""
    side = 0.0 if "no y3 + d3" in slips else s.m3 * s.a2 * (s.y3 + s.d3) * s.c2
    return s.m2 * s.a2 * s.z2 * s.c2 + side + c123(s)


def c123(s, slips=()):
    """Equation 4.23."""
    return s.m3 * (s.d3 * s.z3 * s.su + (s.d3 * s.x3 + s.a3 * s.y3 + s.a3 * s.d3) * s.cu)


def c223(s, slips=()):
    """Equation 4.32."""
    sine = s.s2 if "S2" in slips else s.s3
    return s.m3 * ((-s.a2 * s.x3 - s.a2 * s.a3) * sine + s.a2 * s.z3 * s.c3)


def g2(s, slips=()):
    """Equation 4.46."""
    y = s.y3 if "y3" in slips else s.y2
    return -s.m2 * s.g * ((s.x2 + s.a2) * s.c2 - y * s.s2) - s.m3 * s.g * (
        s.x3 * s.cu + s.z3 * s.su + s.a3 * s.cu + s.a2 * s.c2
    )
