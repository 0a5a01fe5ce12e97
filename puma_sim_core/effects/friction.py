# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Friction of a joint: viscous, dry in several forms, and the bristle that bends before sliding.

All torques are at the joint. Dry friction is a level that opposes sliding and holds at rest
whatever lies below it: the kernel sums the levels of a joint and decides between stick and slip.
With `PRESLIDING` that same sum acts through an elastic bristle instead of a jump.
"""

from __future__ import annotations

from math import exp

from ..backend import inlined
from .base import ALWAYS, BRISTLE, DRY, TORQUE, VARYING, Kind, Parameter

#: past this exponent the Stribeck bump is below the last bit of any level it is added to
_NEGLIGIBLE_EXPONENT = 40.0

VISCOUS = Kind(
    name="viscous_friction", acts=TORQUE, stage=ALWAYS,
    equation="tau = H qd",
    sentence="Friction that grows with the speed; in voltage it cannot be told from back-EMF.",
    parameters=(Parameter("coefficient", "N.m.s/rad", 0.0, 500.0, "H, at the joint"),))

COULOMB = Kind(
    name="coulomb_friction", acts=TORQUE, stage=DRY,
    equation="tau = Fc sgn(qd); at rest any torque up to Fc is held",
    sentence="Dry friction of one level: a step at each reversal, and stick at rest.",
    parameters=(Parameter("torque", "N.m", 0.0, 500.0, "Fc, at the joint"),))

ASYMMETRIC_COULOMB = Kind(
    name="asymmetric_coulomb_friction", acts=TORQUE, stage=DRY,
    equation="tau = Fp for qd > 0, -Fn for qd < 0; at rest any torque from -Fn to Fp is held",
    sentence="Dry friction with a level of its own in each direction, as real PUMA drives have.",
    parameters=(Parameter("positive", "N.m", 0.0, 500.0, "Fp, level for qd > 0"),
                Parameter("negative", "N.m", 0.0, 500.0, "Fn, level for qd < 0, as a magnitude")))

STRIBECK = Kind(
    name="stribeck_friction", acts=TORQUE, stage=DRY | VARYING,
    equation="tau = Fs exp(-(qd/vs)^2) sgn(qd), on top of Coulomb friction",
    sentence="The extra dry friction at very low speed that makes an arm jerk when it crawls.",
    parameters=(Parameter("torque", "N.m", 0.0, 500.0, "Fs, excess over the sliding level"),
                Parameter("velocity", "rad/s", 1e-4, 5.0, "vs, Stribeck velocity", neutral=1.0,
                          default=0.05)))

PRESLIDING = Kind(
    name="presliding_friction", acts=TORQUE, stage=BRISTLE,
    equation="tau = sigma0 z, zdot = qd - |qd| z sigma0 / level(qd)  (Dahl 1968)",
    sentence="A joint's dry friction acting through an elastic bristle: like a spring before it "
             "slides, with a hysteresis loop at each reversal.",
    parameters=(Parameter("stiffness", "N.m/rad", 1.0, 1e6, "sigma0", default=2e4),
                Parameter("torque", "N.m", 0.0, 500.0,
                          "sliding level, added to the joint's other dry friction", default=0.0)))

KINDS = (VISCOUS, COULOMB, ASYMMETRIC_COULOMB, STRIBECK, PRESLIDING)


@inlined
def coulomb_level(p, k):
    """Level [N.m] of symmetric Coulomb friction."""
    return p[k]


@inlined
def asymmetric_level(p, k, direction):
    """Level [N.m] of Coulomb friction against sliding in `direction` (+1 or -1)."""
    return p[k] if direction > 0.0 else p[k + 1]


@inlined
def stribeck_level(p, k, speed):
    """Excess [N.m] over the sliding level at `speed` [rad/s]."""
    if p[k] == 0.0 or speed == 0.0:
        return p[k]
    ratio = speed / p[k + 1]
    ratio *= ratio
    return p[k] * exp(-ratio) if ratio < _NEGLIGIBLE_EXPONENT else 0.0


@inlined
def presliding_level(p, k):
    """Own sliding level [N.m] of the bristle."""
    return p[k + 1]


@inlined
def bristle_flow(deflection, travel, yield_deflection):
    """Deflection [rad] of a bristle after the joint has moved by `travel` [rad].

    The exact solution of z' = qd - |qd| z / zs at constant velocity. It never leaves
    [-zs, zs], however stiff the bristle is, where an explicit step would.
    """
    if travel == 0.0:
        return deflection
    if yield_deflection <= 0.0:
        return 0.0
    # 1 - exp() loses digits of the share, never more than 1e-16 of the yield deflection
    grown = 1.0 - exp(-abs(travel) / yield_deflection)
    end = yield_deflection if travel > 0.0 else -yield_deflection
    return deflection + (end - deflection) * grown
