# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A plant: an arm and the effects that act on it, and the file that holds both.

A model file is YAML: ``format``, ``version`` of the package that wrote it, ``torque_form``,
``parameters`` (the name of a published set, or a whole parameter file inlined) and ``effects``,
each ``{name: ..., joint: ..., PARAMETER: {value: ..., unit: ...}}``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core import __version__
from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.parameters import from_mapping, load_parameters, to_mapping
from puma_sim_core.arm.rigid_body import Lumps, lumped_constants
from puma_sim_core.arm.third_order import TORQUE_FORMS, joint_torque_per_ampere
from puma_sim_core.checks import check_choice
from puma_sim_core.dynamics.types import Constants, Drive, Model
from puma_sim_core.effects import KINDS, VISCOUS, Effect
from puma_sim_core.effects.base import Stage
from puma_sim_core.effects.registry import active_stages, distinct, fill_arm, pack, vanishes
from puma_sim_core.errors import ModelError, ParameterError, one_of
from puma_sim_core.plant.drive_train import DriveTrains

MODEL_FORMAT = "puma-sim model 1"


@dataclass(frozen=True)
class Plant:
    """An arm with effects.

    Attributes
    ----------
    arm : masses, lengths, motors.
    effects : what acts beyond the thesis's model; each kind once a joint, but for those of which it may have several.
    torque_form : "physical" or "printed" (equation 5.2; only with the printed form, or with
        open-circuit motors, does the arm fall as in plot 7.3).

    Raises
    ------
    ParameterError : an effect twice, or an unknown torque form.
    """

    arm: ArmParameters
    effects: tuple[Effect, ...] = ()
    torque_form: str = "physical"

    def __post_init__(self) -> None:
        check_choice(self.torque_form, "torque_form", TORQUE_FORMS)
        effects = distinct(effect.on(self.arm) for effect in self.effects)
        object.__setattr__(self, "effects", effects)
        if any(effect.kind.stage & Stage.TWO_MASS for effect in effects):
            _ = self.constants  # refuses shares of the motors' inertia that no arm can have

    @property
    def axes(self) -> tuple[int, ...]:
        """Joints of the kernel, 0-based, that move, in the order of its voltages and positions; the others are held."""
        return 0, 1, 2

    @property
    def rest(self) -> tuple[float, float, float]:
        """Positions [rad] at which the joints of the kernel that do not move are held."""
        return 0.0, 0.0, 0.0

    @property
    def joints(self) -> int:
        """Number of joints that move: those of its voltages and positions."""
        return len(self.axes)

    def spread(self, values: ArrayLike) -> np.ndarray:
        """(..., 3) values of the kernel's joints for (..., J) of those that move; 0 for the others."""
        values = np.asarray(values)
        if self.joints == 3:
            return values
        out = np.zeros((*values.shape[:-1], 3), dtype=values.dtype)
        out[..., self.axes] = values
        return out

    @property
    def position_unit(self) -> str:
        """Unit of its positions: rad, or m."""
        return "rad"

    @property
    def kernel_effects(self) -> tuple[Effect, ...]:
        """The effects on the joints of the kernel, which always has three."""
        return self.effects

    def with_effects(self, effects: Iterable[Effect]) -> Plant:
        """The plant with further effects; raises ParameterError where one stands twice."""
        return replace(self, effects=self.effects + tuple(effects))

    @classmethod
    def of(cls, name_or_path: str = "bejczy", effects: Iterable[Effect] = (), torque_form: str = "physical") -> Plant:
        """Plant from a published set or a parameter file; raises ParameterError."""
        return cls(load_parameters(name_or_path), tuple(effects), torque_form)

    @cached_property
    def loaded_arm(self) -> ArmParameters:
        """The arm with its loads attached."""
        arm = self.arm
        for effect in self.effects:
            if effect.kind.load is not None:
                arm = effect.kind.load(arm, effect.values)
        return arm

    def lumps_of(self, arm: ArmParameters) -> Lumps:
        """Constants of the rigid body for the arm with what it carries."""
        return lumped_constants(arm)

    @property
    def gear_ratios(self) -> list[float]:
        """Gear ratio [-] of each motor."""
        return [motor.gear_ratio for motor in self.arm.motors]

    @cached_property
    def torque_per_ampere(self) -> tuple[float, float, float]:
        """Torque at the joints per motor current, kT [N.m/A]; equation 5.2."""
        first, second, third = joint_torque_per_ampere(self.arm, self.torque_form).tolist()
        return first, second, third

    @cached_property
    def viscous_friction(self) -> tuple[float, float, float]:
        """Viscous friction at the joints, H [N.m.s/rad]."""
        found = {e.joint: e.values["coefficient"] for e in self.effects if e.kind is VISCOUS}
        return found.get(1, 0.0), found.get(2, 0.0), found.get(3, 0.0)

    @cached_property
    def constants(self) -> Constants:
        """What the step needs of this plant; the table is a list."""
        drive: list[float] = []
        for m, kT, H in zip(self.arm.motors, self.torque_per_ampere, self.viscous_friction):
            admittance = 1.0 / m.inductance if m.inductance else 0.0
            drive += [admittance, float(m.resistance), float(m.back_emf * m.gear_ratio), float(kT), H]
        effects = tuple(e for e in self.kernel_effects if not vanishes(e))
        active, arm, table = active_stages(effects), self.loaded_arm, pack(effects)
        if active & Stage.TWO_MASS:
            trains = DriveTrains(arm, effects, drive)
            arm, table = trains.link_arm, table + trains.table
        for effect in effects:
            if effect.kind.constants is not None:
                fill_arm(table, effect.kind, effect.kind.constants(arm, effect.values))
        body = Lumps(*(float(value) for value in self.lumps_of(arm)))
        if not all(motor.inductance for motor in self.arm.motors):
            active |= Stage.ALGEBRAIC.value
        return Constants(Model(body, Drive(*drive), active), table)

    @property
    def least_rate(self) -> float:
        """Steps in a second [1/s] that the fastest motion of two masses on a joint needs; 0.0 without such."""
        model, table = self.constants
        return float(table[-1]) if model.active & Stage.TWO_MASS else 0.0

    def to_mapping(self) -> dict[str, Any]:
        """Plain values of a model file; every digit is kept."""
        return {
            "format": MODEL_FORMAT,
            "version": __version__,
            "torque_form": self.torque_form,
            "parameters": to_mapping(self.arm),
            "effects": [effect_mapping(effect) for effect in self.effects],
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str | None = None) -> Plant:
        """The inverse of `to_mapping`; see `model_file.plant_of_mapping` for any plant.

        Raises
        ------
        ModelError : a format, effect or key that this version does not know.
        ParameterError : a number that is not usable.
        """
        if not isinstance(mapping, Mapping) or "format" not in mapping:
            raise ModelError("no model", where=where, expected=f"a mapping with format: {MODEL_FORMAT}")
        if mapping["format"] != MODEL_FORMAT:
            expected = f"'{MODEL_FORMAT}', which version {__version__} reads"
            raise ModelError(f"format '{mapping['format']}'", where=where, expected=expected)
        known = ("format", "version", "torque_form", "parameters", "effects")
        for key in mapping:
            if key not in known:
                raise ModelError(f"unknown key '{key}'", where=where, expected=one_of(key, known))
        if "parameters" not in mapping:
            raise ModelError("'parameters' is missing", where=where, expected="the name of a set, or its numbers")
        source, form = mapping["parameters"], mapping.get("torque_form", "physical")
        named = isinstance(source, str)
        arm = load_parameters(source) if named else from_mapping(source, where and f"{where}: parameters")
        return made_of_model(lambda: cls(arm, effects_of_mapping(mapping), form), where)


T = TypeVar("T")


def made_of_model(make: Callable[[], T], where: str | None) -> T:
    """What `make` gives, with its ParameterError as a ModelError that names the file."""
    try:
        return make()
    except ParameterError as error:
        place = " ".join(str(part) for part in (where, error.where) if part)
        raise ModelError(error.what, where=place or None, expected=error.expected) from None


def effects_of_mapping(mapping: Mapping[str, Any], unit_of: Callable[[str], str] = str) -> tuple[Effect, ...]:
    """The effects of a model file; unit_of: the unit there for that of a kind's parameter.

    Raises ParameterError: names the effect and what is wrong with it.
    """
    effects = mapping.get("effects") or []
    if not isinstance(effects, list):
        raise ParameterError(f"effects: {effects!r}"[:80], expected="a list")
    return tuple(_effect_of(entry, unit_of) for entry in effects)


def effect_mapping(effect: Effect, unit_of: Callable[[str], str] = str) -> dict[str, Any]:
    """The entry of an effect in a model file; unit_of as in `effects_of_mapping`."""
    units = {p.name: unit_of(p.unit) for p in effect.kind.parameters}
    joint = {} if effect.joint is None else {"joint": effect.joint}
    values = {name: {"value": value, "unit": units[name]} for name, value in effect.values.items()}
    return {"name": effect.kind.name, **joint, **values}


def _effect_of(entry: Any, unit_of: Callable[[str], str]) -> Effect:
    """The effect of one entry of a model file."""
    if not isinstance(entry, Mapping) or "name" not in entry:
        expected = "{name: ..., joint: ..., PARAMETER: {value, unit}}"
        raise ParameterError(f"{entry!r}", where="effects", expected=expected)
    name = entry["name"]
    if not isinstance(name, str) or name not in KINDS:
        raise ParameterError(
            f"unknown effect '{name}'", where="effects", expected=one_of(name, KINDS, "`puma-sim list`")
        )
    units = {p.name: unit_of(p.unit) for p in KINDS[name].parameters}
    values = {key: value for key, value in entry.items() if key not in ("name", "joint")}
    for key, value in values.items():
        if isinstance(value, Mapping):
            if set(value) != {"value", "unit"} or value["unit"] != units.get(key, value["unit"]):
                expected = f"{{value: ..., unit: {units.get(key)}}}"
                raise ParameterError(f"{key}: {dict(value)!r}", where=f"effect {name}", expected=expected)
            values[key] = value["value"]
    return Effect(KINDS[name], entry.get("joint"), values)
