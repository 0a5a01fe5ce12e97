# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Files that describe mechanisms: ``config/mechanisms`` and those of users.

YAML with ``format``, ``name`` and ``kind``; a number is ``{value: ..., unit: ..., source: ...}``.

``kind: arm``: ``parameters`` (a published set or the path of a parameter file),
``viscous_friction`` and ``torque_scale`` (three values each) and ``relative_deviation``, the
width of the prior of each sort of number as a share of it.

``kind: pendulum``, ``kind: slide`` and ``kind: linkage`` (see `linkage`): a number of a body, a link or a drive also
has ``deviation`` (in its unit), ``relative_deviation`` (a share of it) or ``known: true``, one of them.

``kind: transmission``: joints of which only motor and the two sides of the gear are known (see `transmission`).
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.checks import Reader
from puma_sim_core.errors import ParameterError, one_of
from puma_sim_core.files import places_of_keys, read_yaml
from puma_sim_core.plant.arm_mechanism import WIDTHS, ArmMechanism
from puma_sim_core.plant.linkage.linkage_file import check_bodies, read_linkage
from puma_sim_core.plant.linkage.linkage_mechanism import LinkageMechanism
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT, Mechanism
from puma_sim_core.plant.model_file import load_model
from puma_sim_core.plant.quantities import GREATEST_FRICTION
from puma_sim_core.plant.transmission import read_transmission
from puma_sim_core.resources import config_path

KINDS = ("arm", "linkage", "pendulum", "slide", "transmission")


def read_mechanism(path: str | os.PathLike[str]) -> Mechanism:
    """The mechanism of a file.

    Raises ParameterError: names the file, line, column and key, what is wrong and what was expected.
    """
    mapping = read_yaml(path)
    reader = Reader(str(path), places_of_keys(Path(path).read_text(encoding="utf-8")))
    found = mapping.get("format") if isinstance(mapping, Mapping) else mapping
    if found != MECHANISM_FORMAT:
        reader.fail("format", f"{found!r}", f"'{MECHANISM_FORMAT}'")
    kind = reader.choice(mapping.get("kind"), "kind", KINDS)
    if kind == "arm":
        return _arm(reader, mapping, Path(path).parent)
    if kind == "transmission":
        return read_transmission(mapping, reader)
    linkage = read_linkage(mapping, reader)
    check_bodies(linkage, reader)
    return LinkageMechanism.of(linkage)


def _arm(reader: Reader, mapping: Mapping[str, Any], folder: Path) -> ArmMechanism:
    names = ("format", "name", "kind", "parameters", "viscous_friction", "torque_scale", "relative_deviation")
    reader.keys(mapping, "", names)
    source = reader.text(mapping["parameters"], "parameters", 1)
    beside = folder / source
    arm = load_parameters(beside if beside.is_file() else source)

    def three(key: str, unit: str, low: float) -> tuple[float, ...]:
        return reader.numbers(reader.entry(mapping[key], key, unit)["value"], f"{key}.value", 3, low, GREATEST_FRICTION)

    viscous, scale = three("viscous_friction", "N.m.s/rad", 0.0), three("torque_scale", "N.m", 1e-9)
    shares = reader.keys(mapping["relative_deviation"], "relative_deviation", WIDTHS)
    widths = {name: reader.quantity(shares[name], f"relative_deviation.{name}", "1", 0.0, 1.0) for name in WIDTHS}
    return ArmMechanism.of(arm, viscous, widths, scale, name=reader.text(mapping["name"], "name", 1))


def mechanism_names() -> list[str]:
    """Names of the mechanisms that ship with the package, the default one first."""
    names = sorted(path.stem for path in config_path("mechanisms").glob("*.yaml"))
    return sorted(names, key=lambda name: name != "puma560")


def load_mechanism(
    name_or_path: str | os.PathLike[str] = "puma560",
    *,
    parameters: str | None = None,
    model: str | os.PathLike[str] | None = None,
) -> Mechanism:
    """Read and check a mechanism that ship with the package by its name, or a file by its path.

    Parameters
    ----------
    parameters : published set or parameter file of an arm whose numbers are the start.
    model : model file whose numbers and effects are the start.

    Raises ParameterError, ModelError: no such mechanism or file, or one that is not usable; names the file and the key.
    """
    path, names = Path(name_or_path), mechanism_names()
    if str(name_or_path) in names:
        path = config_path("mechanisms", f"{name_or_path}.yaml")
    elif not path.is_file():
        expected = f"the path of a YAML file or {one_of(name_or_path, names)}"
        raise ParameterError(f"no mechanism or file '{name_or_path}'", expected=expected)
    mechanism = read_mechanism(path)
    if parameters is not None:
        if not isinstance(mechanism, ArmMechanism):
            what = f"parameters '{parameters}' with mechanism '{mechanism.name}'"
            raise ParameterError(what, expected="parameters of an arm with an arm only")
        mechanism = mechanism.with_arm(load_parameters(parameters))
    if model is not None:
        mechanism = mechanism.of_plant(load_model(model))
    return mechanism
