# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What an effect is: one definition that simulating, listing and reporting share.

An effect is something that a real drive does and the thesis's model lacks. Its family's file
holds a `Kind` (name, parameters with units and bounds, equation, where it acts) and its law, a
scalar function that the kernel calls. The parameters of all effects of a plant are packed into
one flat table, joint by joint: the first parameter of a kind, for joint j = 0, 1, 2, stands at
``j * WIDTH + kind.slot``, the next ones behind it. A table without an effect holds its neutral
values, so that kinds can share a stage of the kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING

from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    from puma_sim_core.arm.parameters import ArmParameters
    from puma_sim_core.effects.screening import Screening

#: where an effect acts
VOLTAGE, CURRENT, TORQUE, TRANSMISSION, LOAD, SENSING = (
    "voltage",
    "current",
    "torque",
    "transmission",
    "load",
    "sensing",
)

#: stages of the kernel that cost nothing while no effect of the plant needs them (a bit mask)
SMOOTH, DRY, VARYING, BRISTLE, CURRENT_LIMIT = 1, 2, 4, 8, 16
#: link and rotor are not one: the plant is stepped by `two_mass`
TWO_MASS = 4096
#: dry friction of a joint that depends on the pose
POSED = 8192
#: 32 is the kernel's LOCKED. TILT: gravity of a leaning base; TIMED: what changes with time, taken
#: once a step; DROOP: a supply that gives way; SENSED: the measured position is not the true one;
#: DELAYED: voltages reach the motors late
TILT, TIMED, DROOP, SENSED, DELAYED = 64, 128, 256, 512, 1024
#: stages that are always there: constants of the plant, the voltage at the start of a step
ALWAYS = 0


@dataclass(frozen=True)
class Parameter:
    """One parameter of a kind: ``low <= value <= high`` in ``unit``.

    ``neutral`` is the value that makes the effect vanish. Where the user gives no value,
    ``default`` is taken, or ``from_arm(arm, joint)`` when the effect meets its arm; without
    either the parameter must be given.
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    neutral: float = 0.0
    default: float | None = None
    from_arm: Callable[[ArmParameters, int | None], float] | None = None


@dataclass(frozen=True)
class Kind:
    """A kind of effect.

    Attributes
    ----------
    name : the name in code, in files and in reports.
    acts : one of VOLTAGE, CURRENT, TORQUE, TRANSMISSION, LOAD, SENSING.
    stage : the stage of the kernel that must run when the effect is on.
    equation : the law, as text.
    sentence : one sentence for a person, what it is and how it shows.
    parameters : in the order of the table.
    per_joint : False for an effect of the whole arm; such a one carries no joint.
    load : for LOAD, a function (arm, values) -> arm with the load attached.
    check : what the values must be together, as (values) -> text of what was expected, or None.
    screening : how it is found in a measured log; None where it is only simulated.
    """

    name: str
    acts: str
    stage: int
    equation: str
    sentence: str
    parameters: tuple[Parameter, ...]
    per_joint: bool = True
    load: Callable[[ArmParameters, dict[str, float]], ArmParameters] | None = None
    check: Callable[[dict[str, float]], str | None] | None = None
    screening: Screening | None = None

    def __reduce_ex__(self, protocol):
        """By its name: its functions cannot go to another process."""
        from puma_sim_core.effects import KINDS

        registered = KINDS.get(self.name) is self
        return (_registered, (self.name,)) if registered else super().__reduce_ex__(protocol)


def _registered(name: str) -> Kind:
    from puma_sim_core.effects import KINDS

    return KINDS[name]


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

    def __post_init__(self):
        where = f"effect {self.kind.name}"
        if self.kind.per_joint and (
            isinstance(self.joint, bool) or not isinstance(self.joint, int) or not 1 <= self.joint <= 3
        ):
            raise ParameterError(f"joint {self.joint}", where=where, expected="joint=1, 2 or 3")
        if not self.kind.per_joint and self.joint is not None:
            raise ParameterError(f"joint {self.joint}", where=where, expected="no joint: it acts on the whole arm")
        known = {p.name: p for p in self.kind.parameters}
        for name in self.values:
            if name not in known:
                raise ParameterError(f"unknown parameter '{name}'", where=where, expected=f"one of {', '.join(known)}")
        complete = {}
        for p in self.kind.parameters:
            value = self.values.get(p.name, p.default)
            if value is None and p.from_arm is not None:
                continue
            if value is None:
                raise ParameterError(
                    f"'{p.name}' is missing", where=where, expected=f"{p.name}=VALUE in {p.unit} ({p.meaning})"
                )
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ParameterError(f"{p.name}={value!r}", where=where, expected=f"a number in {p.unit}")
            value = float(value)
            if not isfinite(value) or not p.low <= value <= p.high:
                raise ParameterError(f"{p.name}={value:g}", where=where, expected=f"{p.low:g} to {p.high:g} {p.unit}")
            complete[p.name] = value
        if self.kind.check is not None and len(complete) == len(known):
            expected = self.kind.check(complete)
            if expected:
                raise ParameterError(
                    ", ".join(f"{k}={v:g}" for k, v in complete.items()), where=where, expected=expected
                )
        object.__setattr__(self, "values", complete)

    def on(self, arm: ArmParameters) -> Effect:
        """The effect with the values that it takes from its arm filled in."""
        filled = {
            p.name: self.values[p.name] if p.name in self.values else p.from_arm(arm, self.joint)
            for p in self.kind.parameters
        }
        return Effect(self.kind, self.joint, filled)

    def __hash__(self):
        return hash((self.kind.name, self.joint, tuple(self.values.items())))

    def __str__(self):
        """The form that `parse_effect` reads, with every digit."""
        joint = [] if self.joint is None else [f"joint={self.joint}"]
        items = joint + [f"{name}={value!r}" for name, value in self.values.items()]
        return f"{self.kind.name}:{','.join(items)}"
