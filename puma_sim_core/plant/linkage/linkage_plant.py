# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Plants of linkages: a part of the arm with its drives, on the kernel of the whole arm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from puma_sim_core import __version__
from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.rigid_body import Lumps, lumped_constants
from puma_sim_core.checks import Reader
from puma_sim_core.effects import VISCOUS, Effect, Kind
from puma_sim_core.effects.base import CURRENT, ROTOR_INERTIA, SEVERAL_JOINTS, VOLTAGE, VOLTAGE_DRIVE
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.carrier import Layout, carrier, layout_of, turned
from puma_sim_core.plant.linkage.linkage import BASE, PASSIVE, Axis, Linkage
from puma_sim_core.plant.linkage.linkage_file import linkage_mapping, read_linkage
from puma_sim_core.plant.plant import MODEL_FORMAT, Plant, effect_mapping, effects_of_mapping, made_of_model


def obstacle(linkage: Linkage, kind: Kind, joint: int | None = None) -> tuple[str, str] | None:
    """Why an effect has no meaning on a joint (1-based, None: on any), and what was expected, or None."""
    axes = linkage.moving if joint is None or not kind.per_joint else linkage.moving[joint - 1 : joint]
    found = [_obstacle(linkage, kind, axis) for axis in axes]
    return None if None in found or not found else found[0]


def _obstacle(linkage: Linkage, kind: Kind, axis: Axis) -> tuple[str, str] | None:
    place = axis.place
    what = linkage.kind if len(linkage.moving) == 1 else place
    if kind.per_joint and axis.amplifier == PASSIVE and kind.acts in (VOLTAGE, CURRENT):
        return f"the {what} of '{linkage.name}' has no drive", "a joint with a drive"
    if kind.needs is None:
        return None
    lacking = {
        SEVERAL_JOINTS: (not linkage.turns(BASE), f"on a {linkage.kind} whose base does not turn"),
        ROTOR_INERTIA: (
            linkage.numbers(linkage.values, place)["motor_inertia"] == 0.0,
            f"the {what} of '{linkage.name}' has no motor_inertia",
        ),
        VOLTAGE_DRIVE: (not axis.on_voltage, f"the {what} of '{linkage.name}' is not on voltage"),
    }
    lacks, words = lacking[kind.needs.what]
    return (words, kind.needs.expected) if lacks else None


@dataclass(frozen=True)
class LinkagePlant(Plant):
    """A plant of the joints of a linkage that move; `LinkagePlant.of` makes one.

    `effects` are on these joints, numbered from 1, in rad and N.m, or in m and N; voltages, positions and states have a
    column for each. Some effects have no meaning here: see `obstacle`.

    Raises ParameterError: such an effect, or one on another joint.
    """

    body: Linkage = field(kw_only=True)

    def __post_init__(self) -> None:
        for effect in self.effects:
            where, values, J = f"effect {effect.kind.name}", effect.on(self.arm).values, self.joints
            if effect.joint is not None and effect.joint > J:
                expected = "joint=1" + (f" to {J}" if J > 1 else "")
                what = f"{expected}: '{self.body.name}' has {J} joint{'s' * (J > 1)}"
                raise ParameterError(f"joint {effect.joint}", where=where, expected=what)
            reason = obstacle(self.body, effect.kind, effect.joint)
            if reason is not None:
                raise ParameterError(reason[0], where=where, expected=reason[1])
            if effect.kind.load is not None and (
                values["x"] != 0.0 or values["y"] != 0.0 or (self.body.kind == "slide" and values["z"] != 1.0)
            ):
                expected = "a mass alone, or z along the last link"
                raise ParameterError(f"beside the {self.body.kind}", where=where, expected=expected)
        super().__post_init__()

    @classmethod
    def of(  # type: ignore[override]
        cls, body: Linkage, effects: Iterable[Effect] = (), values: Mapping[str, float] | None = None
    ) -> LinkagePlant:
        """The plant of a linkage; `values` replace numbers of it by name.

        Raises ParameterError: an effect that cannot be on it.
        """
        body = body if not values else body.with_values(values)
        return cls(carrier(body, body.values), tuple(effects), body=body)

    @cached_property
    def layout(self) -> Layout:
        """Where the linkage stands in the kernel."""
        return layout_of(self.body)

    @property
    def axes(self) -> tuple[int, ...]:
        return self.layout.axes

    @property
    def rest(self) -> tuple[float, float, float]:
        return self.layout.rest

    def lumps_of(self, arm: ArmParameters) -> Lumps:
        return turned(lumped_constants(arm), self.layout.turn)

    @property
    def position_unit(self) -> str:
        return self.body.unit_of("rad")

    @property
    def kernel_effects(self) -> tuple[Effect, ...]:
        return tuple(
            e if e.joint is None else Effect(e.kind, self.axes[e.joint - 1] + 1, e.values) for e in self.effects
        )

    @cached_property
    def viscous_friction(self) -> tuple[float, float, float]:
        found = [0.0, 0.0, 0.0]
        for joint, (axis, place) in enumerate(zip(self.body.moving, self.axes), start=1):
            own = self.body.numbers(self.body.values, axis.place)["viscous_friction"]
            more = [e.values["coefficient"] for e in self.effects if e.kind is VISCOUS and e.joint == joint]
            found[place] = own + sum(more)
        return found[0], found[1], found[2]

    def to_mapping(self) -> dict[str, Any]:
        return {
            "format": MODEL_FORMAT,
            "version": __version__,
            "mechanism": linkage_mapping(self.body),
            "effects": [effect_mapping(e, self.body.unit_of) for e in self.effects],
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str | None = None) -> LinkagePlant:
        """The inverse of `to_mapping`; raises ModelError as `Plant.from_mapping`."""

        def make() -> LinkagePlant:
            Reader(None).keys(mapping, "", ("format", "version", "mechanism", "effects"), ("version", "effects"))
            body = read_linkage(mapping["mechanism"], Reader("mechanism"))
            return cls.of(body, effects_of_mapping(mapping, body.unit_of))

        return made_of_model(make, where)
