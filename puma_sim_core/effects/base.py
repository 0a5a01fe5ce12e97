# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What an effect is: the contract of every file in this folder, and a guide to writing one.

An effect is something that a real drive does and the thesis's model lacks. One file holds all of it: a module with a
`Kind` named ``EFFECT``. The kernel, the screening of logs, the voltages of known effects, lists, reports and the
documentation are derived from the registry of these.

To add one:

1. Write a file with the law: a scalar function of the effect's parameters ``p[k], p[k + 1], ...`` and of what its
   `Point` passes it, decorated with `jit.inlined`. It must cost nothing and give 0 where its parameters are neutral.
2. Put it in ``EFFECT = Kind(...)``: name, equation, one sentence, parameters with unit and bounds, and its ``laws``.
   The points say where a law acts and how the laws of several effects are combined.
3. A law with a memory is a `Memory`: its deflection follows the travel of the joint.
4. To be found in logs it needs a `Screening`: regressors of the voltage that it costs, a prior of their coefficients,
   and plausible sizes. Most regressors are one line with the helpers of `effects.shared.columns`.
5. `look_alikes` names what it may be mistaken for, with the sentence that tells the two apart, in both directions.
6. In this folder the file is found by itself. From outside the package, name it by ``--effects FILE``, by the
   environment variable PUMA_SIM_EFFECTS, or by an entry point of the group ``puma_sim.effects``.

The parameters of all effects of a plant are packed into one flat table, joint by joint: those of an effect on joint
j = 0, 1, 2 begin at ``j * WIDTH + place``. A table without an effect holds its neutral values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from enum import Enum, IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple

from puma_sim_core.checks import is_number
from puma_sim_core.errors import ParameterError, one_of

if TYPE_CHECKING:
    import numpy as np

    from puma_sim_core.arm.arm import ArmParameters
    from puma_sim_core.effects.screening import ByJoint, Screening, Signals, Values

#: where an effect acts
VOLTAGE, CURRENT, TORQUE = "voltage", "current", "torque"
TRANSMISSION, LOAD, SENSING = "transmission", "load", "sensing"


class Stage(IntFlag):
    """Optional stages of the step: each costs nothing while no effect of the plant needs it."""

    ALWAYS = 0  # constants of the plant, the voltage at the start of a step
    SMOOTH = 1  # torques that depend on position and velocity
    DRY = 2  # dry friction: stick and slip
    VARYING = 4  # dry friction that depends on the speed
    BRISTLE = 8  # torques of deflections that follow the travel of the joints
    CURRENT_LIMIT = 16
    LOCKED = 32  # set by the step: a joint is constrained from outside, or sticks
    TILT = 64  # torques on all joints that depend on the pose
    TIMED = 128  # what changes with time, taken once a step
    DROOP = 256  # a supply that sags
    SENSED = 512  # the measured position is not the true one
    DELAYED = 1024  # voltages reach the motors late
    ALGEBRAIC = 2048  # set by the plant: a motor without inductance
    TWO_MASS = 4096  # link and rotor are not one
    POSED = 8192  # dry friction that depends on the pose
    MEMORY = 16384  # an effect with a deflection of its own


class Point(Enum):
    """Where a law acts: (arguments behind p and k, how several laws are combined, stage).

    p is the packed table and k the place of the effect's first parameter in it. Units: rad, rad/s, N.m at the joint, V,
    A, s. "chain" passes the last argument on from law to law, "any" is true where one law is.
    """

    TERMINAL = ("v", "chain", Stage.ALWAYS)  #: voltage behind the amplifier's losses, for the one before
    SUPPLY = ("v", "chain", Stage.ALWAYS)  #: voltage that the supply can give, for the one before; behind TERMINAL
    #: share of the supply that is left under the currents of all motors; of the whole arm
    SUPPLY_SHARE = ("i1, i2, i3", "product", Stage.DROOP)
    CURRENT_RATE = ("i, rate", "chain", Stage.CURRENT_LIMIT)  #: rate of a motor's current, for the one before
    CURRENT = ("i", "chain", Stage.CURRENT_LIMIT)  #: current within its bound, for the one before
    CURRENT_BOUND = ("", "least", Stage.CURRENT_LIMIT)  #: greatest current; the least of all holds
    MOTOR_TORQUE = ("q, qd", "sum", Stage.SMOOTH)  #: torque on the motor or its gear, positive against positive motion
    #: torque on the link, behind the gear, positive against positive motion
    LINK_TORQUE = ("q, qd", "sum", Stage.SMOOTH)
    #: dry friction that depends on nothing but the direction (+1, -1) of sliding
    LEVEL = ("direction", "sum", Stage.DRY)
    SPEED_LEVEL = ("speed", "sum", Stage.DRY | Stage.VARYING)  #: dry friction that depends on the speed (>= 0)
    #: dry friction that depends on position, gravity's torque, and the motor's after viscous friction
    POSE_LEVEL = ("q, gravity, torque", "sum", Stage.DRY | Stage.POSED)
    HAS_POSE_LEVEL = ("", "any", Stage.DRY | Stage.POSED)  #: whether there is any dry friction of the point above
    #: torque that the motor gives where a motion takes `torque` without the pose's friction; sign of the velocity
    LOADED_TORQUE = ("gravity, sign, torque", "chain", Stage.DRY | Stage.POSED)
    #: stiffness of the bristle that a joint's dry friction acts through [N.m/rad]
    BRISTLE_STIFFNESS = ("", "sum", Stage.BRISTLE)
    #: torques on all three joints: (width of a joint's table, q1, trig, body) -> triple; of the whole arm
    ARM_TORQUE = ("width, q1, trig, body", "triple", Stage.TILT)
    RESISTANCE_FACTOR = ("time", "product", Stage.TIMED)  #: factor of the winding's resistance at a time
    VISCOUS_FACTOR = ("time", "product", Stage.TIMED)  #: factor of viscous friction at a time
    #: torque from outside in the direction of +q: mean from `time` on over `step`, the value for step 0
    PUSH = ("time, step", "sum", Stage.TIMED)
    SENSOR_OFFSET = ("", "sum", Stage.SENSED)  #: constant that the sensor adds to the position
    SENSOR_ERROR = ("q", "sum", Stage.SENSED)  #: what else the sensor adds to the position
    SENSOR_SLOPE = ("q", "sum", Stage.SENSED)  #: what the sensor adds to a unit of velocity
    SENSOR_LAG = ("", "sum", Stage.SENSED)  #: time constant of the sensor
    DELAY = ("", "sum", Stage.DELAYED)  #: time by which voltages reach the motors late; of the whole arm

    def __init__(self, arguments: str, combined: str, stage: Stage):
        # equal values would make members aliases of one another
        self.arguments, self.combined, self.stage = arguments, combined, stage

    def __new__(cls, *value: Any) -> Point:
        member = object.__new__(cls)
        member._value_ = len(cls.__members__)
        return member


class Law(NamedTuple):
    """A function at a point; `order` sorts the laws of a point before the order of effects does."""

    point: Point
    function: Callable[..., Any]
    order: int = 0


class Memory(NamedTuple):
    """A deflection [rad] of a joint that follows its travel, and its torque."""

    #: (p, k, deflection, travel) -> deflection after a travel [rad], exact for a constant velocity
    follow: Callable[..., Any]
    #: (p, k, deflection) -> torque [N.m], positive against positive motion
    torque: Callable[..., Any]


class Train(NamedTuple):
    """What an effect makes of a joint's drive train."""

    spring: tuple[float, float] | None = None  #: (K [N.m/rad], B [N.m.s/rad]) in series with others
    gap: float = 0.0  #: [rad]
    motor_share: float | None = None  #: part of the motor's inertia that turns with the rotor
    wave: tuple[float, float, float] | None = None  #: (amplitude [rad], periods a turn, phase) of the gear's error


class Needs(NamedTuple):
    """What a mechanism must have for an effect to mean something: `what` is one of SEVERAL_JOINTS, ROTOR_INERTIA and
    VOLTAGE_DRIVE; `expected` ends the error otherwise."""

    what: str
    expected: str


SEVERAL_JOINTS, ROTOR_INERTIA, VOLTAGE_DRIVE = "several joints", "rotor inertia", "motor on voltage"


class Role(Enum):
    """What a parameter says of its effect."""

    SIZE = "how much"
    RATE = "how fast or how stiff; machines have no less than its least plausible value"
    PLACE = "where, when, or how long"
    STRUCTURE = "given by the construction: a fit leaves it alone"


SIZE, RATE, PLACE, STRUCTURE = Role


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect: ``low <= value <= high`` in ``unit``.

    It must be given where it has neither a `default` nor a `from_arm`.
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    role: Role = SIZE  #: what it says of the effect
    plausible: tuple[float, float] | None = None  #: (low, high) on a machine; beyond them it is no name
    _: KW_ONLY
    neutral: float = 0.0  #: the value that makes the effect vanish
    default: float | None = None  #: taken where the user gives no value
    from_arm: Callable[[ArmParameters, Any], float] | None = None  #: (arm, joint) -> default on an arm
    prior: tuple[float, float] | None = None  #: (median, factor of one deviation) where a log may tell little about it
    logarithmic: bool | None = None  #: a fit moves its logarithm; None: that of a RATE above 0
    step: float | str | None = None  #: how far it must move to matter, or the parameter that says so; None: by unit
    inverse: bool = False  #: more of it means less of the effect
    softened_by: str | None = None  #: a stiffness [N.m/rad] by which its edge is soft
    #: an error of the position, or a stiffness (`inverse`) by its twist under the torque of a log: encoder steps below
    #: which it may as well be the encoder's own
    steps: float | None = None
    #: a time by which something is late: periods of the log by which its stamp may be late as well
    periods: float = 0.0

    def __post_init__(self) -> None:
        if self.logarithmic is None:
            object.__setattr__(self, "logarithmic", self.role is RATE and self.low > 0.0)

    def checked(self, value: Any, where: str) -> float:
        """A value within the bounds; raises ParameterError."""
        if value is None:
            expected = f"{self.name}=VALUE in {self.unit} ({self.meaning})"
            raise ParameterError(f"'{self.name}' is missing", where=where, expected=expected)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ParameterError(f"{self.name}={value!r}", where=where, expected=f"a number in {self.unit}")
        if not is_number(value) or not self.low <= value <= self.high:
            expected = f"{self.low:g} to {self.high:g} {self.unit}"
            raise ParameterError(f"{self.name}={value:g}", where=where, expected=expected)
        return float(value)


class LookAlike(NamedTuple):
    """Another effect that may be mistaken for this one."""

    other: str
    mine: str  #: what tells this effect from the other
    its: str  #: what tells the other from this one


def _numbered(first: str, number: int) -> str:
    """Name of an effect that is one of several of its kind on a joint."""
    return first if number == 1 else f"{first}_{number}"


@dataclass(frozen=True)
class Kind:
    """An effect of the library; `Effect` is one with values on a joint."""

    name: str  #: in code, in files and in reports; that of its file
    acts: str  #: one of VOLTAGE, CURRENT, TORQUE, TRANSMISSION, LOAD, SENSING
    equation: str  #: the law, as text
    sentence: str  #: for a person, what it is and how it shows
    parameters: tuple[Parameter, ...]  #: in the order of the table
    order: int = 1000  #: position in lists and reports
    laws: tuple[Law, ...] = ()  #: what the kernel sums
    memory: Memory | None = None
    per_joint: bool = True  #: False for an effect of the whole arm; such a one carries no joint
    check: Callable[[dict[str, float]], str | None] | None = None  #: values -> what was expected of them together
    #: (arm, values) -> arm with the load attached, for LOAD
    load: Callable[[ArmParameters, dict[str, float]], ArmParameters] | None = None
    #: (arm, values) -> the numbers that stand in the table in place of the parameters, for ARM_TORQUE
    constants: Callable[[ArmParameters, dict[str, float]], Sequence[float]] | None = None
    train: Callable[[dict[str, float]], Train] | None = None  #: values -> what it makes of the joint's drive train
    #: values -> (stiffness, damping) that a soft drive train swings against
    stiffening: Callable[[dict[str, float]], tuple[float, float]] | None = None
    vanishes: Callable[[dict[str, float]], bool] | None = None  #: values -> whether it leaves link and motor one
    #: (signals, joint, values, torque (n, J)) -> voltages along a measured motion, where its laws do not give them
    known_voltage: Callable[[Signals, int, Values, np.ndarray], ByJoint] | None = None
    screening: Screening | None = None  #: how it is found in a measured log; None where it is only simulated
    look_alikes: tuple[LookAlike, ...] = ()  #: what it may be mistaken for, where `relations` does not list it
    contains: tuple[str, ...] = ()  #: its special cases, where `relations` does not list them
    alike_in_part: tuple[str, ...] = ()  #: those that it only looks like while a joint stays on one side
    drawn_against: tuple[str, ...] = ()  #: signals to draw its residual against, the first one that there is
    directed: bool = False  #: the residual is drawn times the direction of motion
    needs: Needs | None = None  #: what a mechanism must have
    feigned: bool = False  #: feedback in a recording makes it out of noise
    repeatable: bool = True  #: a motion can bring it about again
    most: int = 1  #: how many of it one joint may have: the registry makes NAME_2 and so on for those after the first
    number: int = 1  #: which of them it is
    fine: bool = False  #: regressors need a fine step
    shifts_zero: bool = False  #: its size is a wrong zero of the joint's sensor
    example: str = ""  #: as on a command line

    @property
    def first(self) -> str:
        """Name of the first one on a joint, which users know it by."""
        return self.name if self.number == 1 else self.name.removesuffix(f"_{self.number}")

    @property
    def before(self) -> str | None:
        """Name of the one that a joint has before this one; None for the first."""
        return None if self.number == 1 else _numbered(self.first, self.number - 1)

    @property
    def further(self) -> tuple[Kind, ...]:
        """Those that one joint may have after the first."""
        numbers = range(2, self.most + 1) if self.number == 1 else ()
        own = {n: _numbered(self.name, n) for n in numbers}
        return tuple(
            replace(self, name=name, number=n, example=self.example.replace(self.name, name, 1))
            for n, name in own.items()
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all that one joint may have of it."""
        return tuple(_numbered(self.first, n) for n in range(1, self.most + 1))

    @property
    def special_cases(self) -> tuple[str, ...]:
        """Effects that it includes wherever the joint is: where they are enough it is not asked for."""
        return tuple(name for name in self.contains if name not in self.alike_in_part)

    @property
    def stage(self) -> int:
        """Stages of the step that must run when the effect is on."""
        mask = Stage.ALWAYS
        for law in self.laws:
            mask |= law.point.stage
        if self.has_bristle:
            mask = Stage.BRISTLE  # its dry friction is part of the bristle
        if self.memory is not None:
            mask |= Stage.BRISTLE | Stage.MEMORY
        return int(mask if self.train is None else mask | Stage.TWO_MASS)

    @property
    def has_bristle(self) -> bool:
        """Whether the joint's dry friction acts through it, and neither sticks nor slips."""
        return any(law.point is Point.BRISTLE_STIFFNESS for law in self.laws)

    @property
    def dry(self) -> bool:
        """Whether it is a level of dry friction."""
        return any(law.point in (Point.LEVEL, Point.SPEED_LEVEL, Point.POSE_LEVEL) for law in self.laws)

    @property
    def two_masses(self) -> bool:
        """Whether it gives a joint two masses: a model with it takes some ten times as long to run."""
        values = {p.name: p.high if p.default is None else p.default for p in self.parameters}
        return self.train is not None and self.train(values).spring is not None

    @property
    def plausible(self) -> tuple[tuple[str, float, float], ...]:
        """(parameter, low, high) of plausible sizes; the one that tells what is detectable stands first."""
        main = self.screening.size if self.screening is not None else None
        listed = sorted(self.parameters, key=lambda p: p.name != main)
        return tuple((p.name, *p.plausible) for p in listed if p.plausible is not None)

    def told_from(self, other: str) -> str | None:
        """What tells this effect from a look-alike; None where the other is none."""
        return next((pair.mine for pair in self.look_alikes if pair.other == other), None)

    def parameter(self, name: str) -> Parameter:
        """The parameter of a name; KeyError without one."""
        return {p.name: p for p in self.parameters}[name]


@dataclass(frozen=True)
class Effect:
    """An effect with its values, on one joint (1-based) or, with ``joint=None``, the whole arm.

    Raises
    ------
    ParameterError : unknown parameter, missing value, value out of bounds, wrong joint.
    """

    kind: Kind
    joint: int | None
    values: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f"effect {self.kind.name}"
        if self.kind.per_joint and (type(self.joint) is not int or not 1 <= self.joint <= 3):
            what = "no joint" if self.joint is None else f"joint {self.joint}"
            raise ParameterError(what, where=where, expected="joint=1, 2 or 3")
        if not self.kind.per_joint and self.joint is not None:
            raise ParameterError(f"joint {self.joint}", where=where, expected="no joint: it acts on the whole arm")
        known = [p.name for p in self.kind.parameters]
        for name in self.values:
            if name not in known:
                raise ParameterError(f"unknown parameter '{name}'", where=where, expected=one_of(name, known))
        complete = {}
        for p in self.kind.parameters:
            value = self.values.get(p.name, p.default)
            if value is not None or p.from_arm is None:
                complete[p.name] = p.checked(value, where)
        if self.kind.check is not None and len(complete) == len(known) and (expected := self.kind.check(complete)):
            what = ", ".join(f"{name}={value:g}" for name, value in complete.items())
            raise ParameterError(what, where=where, expected=expected)
        object.__setattr__(self, "values", complete)

    @property
    def place(self) -> float:
        """Where or when it acts: its first parameter that says so, 0 without one."""
        return next((self.values[p.name] for p in self.kind.parameters if p.role is PLACE), 0.0)

    def overlaps(self, other: Effect) -> bool:
        """Whether it acts where another of its kind does: nearer than the mean of what their places are counted by."""
        widths = [p.step for p in self.kind.parameters if p.role is PLACE and isinstance(p.step, str)]
        if not widths:
            return True
        return abs(self.place - other.place) < 0.5 * (self.values[widths[0]] + other.values[widths[0]])

    def on(self, arm: ArmParameters) -> Effect:
        """The effect with the values that it takes from its arm filled in."""
        missing = [p for p in self.kind.parameters if p.from_arm and p.name not in self.values]
        taken = {p.name: p.from_arm(arm, self.joint) for p in missing if p.from_arm}
        return Effect(self.kind, self.joint, self.values | taken)

    def __hash__(self) -> int:
        return hash((self.kind.name, self.joint, tuple(self.values.items())))

    def __str__(self) -> str:
        """The form that `parse_effect` reads, with every digit."""
        joint = [] if self.joint is None else [f"joint={self.joint}"]
        items = joint + [f"{name}={value!r}" for name, value in self.values.items()]
        return f"{self.kind.name}:{','.join(items)}"
