# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Friction of a joint: viscous, dry in several forms, and the bristle that bends before sliding.

All torques are at the joint. Dry friction is a level that opposes sliding and holds at rest
whatever lies below it: the kernel sums the levels of a joint and decides between stick and slip.
With `PRESLIDING` that same sum acts through an elastic bristle instead of a jump.
"""

from __future__ import annotations

from math import cos, exp

from puma_sim_core.effects.base import ALWAYS, BRISTLE, DRY, POSED, SMOOTH, TIMED, TORQUE, VARYING, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS
from puma_sim_core.jit import inlined

#: past this exponent the Stribeck bump is below the last bit of any level it is added to
_NEGLIGIBLE_EXPONENT = 40.0
#: least share of its torque that a gear passes on when it drives; with less it would block
_LEAST_SHARE = 0.02

VISCOUS = Kind(
    name="viscous_friction",
    acts=TORQUE,
    stage=ALWAYS,
    equation="tau = H qd",
    sentence="Friction that grows with the speed; in voltage it cannot be told from back-EMF.",
    parameters=(Parameter("coefficient", "N.m.s/rad", 0.0, 500.0, "H, at the joint"),),
)

COULOMB = Kind(
    name="coulomb_friction",
    acts=TORQUE,
    stage=DRY,
    screening=SCREENINGS["coulomb_friction"],
    equation="tau = Fc sgn(qd); at rest any torque up to Fc is held",
    sentence="Dry friction of one level: a step at each reversal, and stick at rest.",
    parameters=(Parameter("torque", "N.m", 0.0, 500.0, "Fc, at the joint"),),
)

ASYMMETRIC_COULOMB = Kind(
    name="asymmetric_coulomb_friction",
    acts=TORQUE,
    stage=DRY,
    screening=SCREENINGS["asymmetric_coulomb_friction"],
    equation="tau = Fp for qd > 0, -Fn for qd < 0; at rest any torque from -Fn to Fp is held",
    sentence="Dry friction with a level of its own in each direction, as real PUMA drives have.",
    parameters=(
        Parameter("positive", "N.m", 0.0, 500.0, "Fp, level for qd > 0"),
        Parameter("negative", "N.m", 0.0, 500.0, "Fn, level for qd < 0, as a magnitude"),
    ),
)

STRIBECK = Kind(
    name="stribeck_friction",
    acts=TORQUE,
    stage=DRY | VARYING,
    screening=SCREENINGS["stribeck_friction"],
    equation="tau = (Fc + Fs exp(-(qd/vs)^2)) sgn(qd), on top of other dry friction",
    sentence="The extra dry friction at very low speed that makes an arm jerk when it crawls.",
    parameters=(
        Parameter("torque", "N.m", 0.0, 500.0, "Fs, excess over the sliding level"),
        Parameter("velocity", "rad/s", 1e-4, 5.0, "vs, Stribeck velocity", neutral=1.0, default=0.05),
        Parameter("sliding", "N.m", 0.0, 500.0, "Fc, Coulomb level under the bump", default=0.0),
    ),
)

PRESLIDING = Kind(
    name="presliding_friction",
    acts=TORQUE,
    stage=BRISTLE,
    screening=SCREENINGS["presliding_friction"],
    equation="tau = sigma0 z, zdot = qd - |qd| z sigma0 / level(qd)  (Dahl 1968)",
    sentence="A joint's dry friction acting through an elastic bristle: like a spring before it "
    "slides, with a hysteresis loop at each reversal.",
    parameters=(
        Parameter("stiffness", "N.m/rad", 1.0, 1e6, "sigma0", default=2e4),
        Parameter("torque", "N.m", 0.0, 500.0, "sliding level, added to the joint's other dry friction", default=0.0),
    ),
)

QUADRATIC = Kind(
    name="quadratic_friction",
    acts=TORQUE,
    stage=SMOOTH,
    screening=SCREENINGS["quadratic_friction"],
    equation="tau = c qd |qd|",
    sentence="Drag that grows with the square of the speed, as of churned grease or a fan.",
    parameters=(Parameter("coefficient", "N.m.s2/rad2", 0.0, 500.0, "c, at the joint"),),
)

LOAD_DEPENDENT = Kind(
    name="load_dependent_friction",
    acts=TORQUE,
    stage=DRY | POSED,
    screening=SCREENINGS["load_dependent_friction"],
    equation="tau = mu |G(q) + a (T - G(q))| sgn(qd), T = N kt i - H qd what the motor gives; at "
    "rest any torque up to that level is held",
    sentence="Dry friction of the gears that grows with the load they carry: the weight of the "
    "pose (a = 0), the torque that they transmit (a = 1), or a mean of the two.",
    parameters=(
        Parameter("coefficient", "1", 0.0, 1.0, "mu, of the load"),
        Parameter(
            "transmitted",
            "1",
            0.0,
            1.0,
            "a, share of the motor's torque in the load, of gravity's the rest",
            default=0.0,
        ),
    ),
)

POSITION_DEPENDENT = Kind(
    name="position_dependent_friction",
    acts=TORQUE,
    stage=DRY | POSED,
    screening=SCREENINGS["position_dependent_friction"],
    equation="tau = max(F0 + F1 cos(q - f), 0) sgn(qd); at rest any torque up to it is held",
    sentence="Dry friction that is greater in one part of the joint's range than in another.",
    parameters=(
        Parameter("torque", "N.m", 0.0, 500.0, "F0, mean level"),
        Parameter("amplitude", "N.m", 0.0, 500.0, "F1, by which it varies"),
        Parameter("angle", "rad", -10.0, 10.0, "f, where it is greatest", default=0.0),
    ),
)

WARM_UP = Kind(
    name="friction_warm_up",
    acts=TORQUE,
    stage=TIMED,
    screening=SCREENINGS["friction_warm_up"],
    equation="H(t) = H (1 - share (1 - exp(-t/T))), H of viscous_friction",
    sentence="The joint's viscous friction falls as its grease gets warm; at time 0 it is cold.",
    parameters=(
        Parameter("share", "1", 0.0, 1.0, "part of H that is lost in the end"),
        Parameter("time_constant", "s", 0.01, 1e5, "T", neutral=1.0),
    ),
)

KINDS = (
    VISCOUS,
    COULOMB,
    ASYMMETRIC_COULOMB,
    STRIBECK,
    PRESLIDING,
    QUADRATIC,
    LOAD_DEPENDENT,
    POSITION_DEPENDENT,
    WARM_UP,
)


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
def stribeck_sliding_level(p, k):
    """Coulomb level [N.m] under the Stribeck bump."""
    return p[k + 2]


@inlined
def load_level(p, k, gravity, torque):
    """Level [N.m] where the joint bears the gravity torque `gravity` [N.m] and its motor gives
    `torque` [N.m], its viscous friction taken off."""
    if p[k + 1] == 0.0:
        return p[k] * abs(gravity)
    return p[k] * abs(gravity + p[k + 1] * (torque - gravity))


@inlined
def loaded_torque(p, k, gravity, torque, sign):
    """Torque [N.m] of a motor that gives `torque` and, on top, what this friction takes of it.

    sign : of the velocity, -1..1. The friction loads the gear that it is made by: the load u is
    c + s |u| with c that of `torque`, s = sign mu a, |s| < 1, so that |u| = |c| / (1 - s sgn c).
    """
    load = gravity + p[k + 1] * (torque - gravity)
    own = sign * p[k]
    share = 1.0 - p[k + 1] * (own if load > 0.0 else -own)
    return torque + own * abs(load) / max(share, _LEAST_SHARE)


@inlined
def position_level(p, k, q):
    """Level [N.m] at position q [rad]."""
    if p[k + 1] == 0.0:
        return p[k]
    return max(p[k] + p[k + 1] * cos(q - p[k + 2]), 0.0)


@inlined
def quadratic_torque(p, k, qd):
    """Drag [N.m] at velocity qd [rad/s]."""
    return p[k] * qd * abs(qd)


@inlined
def warmed_share(p, k, time):
    """Share of the viscous friction that is left after `time` [s]; all of it before 0."""
    return 1.0 - p[k] * (1.0 - exp(-max(time, 0.0) / p[k + 1]))


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
