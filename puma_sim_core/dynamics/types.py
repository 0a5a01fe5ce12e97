# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the step takes and gives: named tuples, so that plain Python and compiled code share them.

Constants (`Model`), state (`State`) and what is asked for (`Rows`, `ServoLoop`) stand apart: a step takes them and
returns a new state.

Words that all functions of this folder share:

x : state of the arm, nine numbers: positions [rad], velocities [rad/s] and motor currents [A] of the three joints.
z : deflections of the bristles [rad], positions [rad] and velocities [rad/s] of the links, further deflections.
m : measured positions [rad], the true ones where nothing is SENSED.
v : voltages [V] at the motors, held over a step (with a soft drive, torques [N.m] on the links behind them).
h : length of a step [s].
p : packed table of effects (`effects.registry.pack`), behind it the drive trains where joints are soft.
lock : (l1, l2, l3, a1, a2, a3): l = 1.0 takes the joint's row out, its acceleration is a [rad/s^2].
slip : (s1, s2, s3, c1, c2, c3): direction of sliding against dry friction, 0.0 without, and the torque, of friction
    and from outside, that stays the same over a step [N.m].
bend : torques of the deflections [N.m]; level : bounds of the bristles [N.m]; push : torques from outside [N.m].
trig : (sin q2, cos q2, sin(q2 + q3), cos(q2 + q3)).
system : the equations M a = b of the joints, row by row from the diagonal: m11, m12, m13, m22, m23, m33, b1, b2, b3.
"""

from typing import Any, NamedTuple

from puma_sim_core.arm.rigid_body import Lumps
from puma_sim_core.jit import Vec


class Drive(NamedTuple):
    """Constants of the motors, joint by joint: 1/L (0.0 where there is none) [1/H], R [ohm], ke N [V.s/rad], kT
    [N.m/A] and H [N.m.s/rad]."""

    admittance1: float
    resistance1: float
    emf1: float
    torque1: float
    viscous1: float
    admittance2: float
    resistance2: float
    emf2: float
    torque2: float
    viscous2: float
    admittance3: float
    resistance3: float
    emf3: float
    torque3: float
    viscous3: float


class Model(NamedTuple):
    """Constants of a plant: the rigid body (`Lumps`), its motors (`Drive`), a bit mask of active stages."""

    body: Any
    drive: Any
    active: int


class Constants(NamedTuple):
    """All that a run needs of a plant: `Model`, and the packed table of its effects.

    Inside a run the table stands apart from the model: to make a tuple with an array in it costs compiled code more
    than a step's arithmetic.
    """

    model: Model
    table: Any

    @property
    def body(self) -> Lumps:
        """Constants of the rigid body."""
        return self.model.body

    @property
    def drive(self) -> Drive:
        """Constants of the motors."""
        return self.model.drive

    @property
    def active(self) -> int:
        """Bit mask of the stages that the plant needs."""
        return self.model.active


class State(NamedTuple):
    """State of a plant: of the arm, of what bends, and what its sensors show."""

    x: tuple[float, ...]
    z: tuple[float, ...]
    m: tuple[float, ...]


class Rows(NamedTuple):
    """Voltages row by row: (n, 3) [V], held from time (n,) [s] on for count (n,) steps of step (n,) seconds."""

    voltage: Any
    time: Any
    count: Any
    step: Any


class ServoLoop(NamedTuple):
    """The digital servo around a run: from time `start` [s] on each setpoint acts for `samples` samples of `steps`
    steps of h seconds. table : of `servo.ServoConfig`; memory, late : flat, taken up and left (`servo_memory`,
    `delay.SampledDelay`)."""

    start: float
    samples: int
    steps: int
    h: float
    table: Any
    memory: Any
    late: Any


#: no row is taken out; nothing slides or is pushed; nothing bends
FREE: Vec = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NO_SLIP: Vec = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
STILL: Vec = (0.0, 0.0, 0.0)
