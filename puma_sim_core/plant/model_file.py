# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Model files: a plant of any kind, with its parameters and effects."""

import os
from collections.abc import Mapping
from typing import Any

from puma_sim_core.errors import ModelError
from puma_sim_core.files import read_yaml, write_yaml
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant
from puma_sim_core.plant.plant import MODEL_FORMAT, Plant


def plant_of_mapping(mapping: Mapping[str, Any], where: str | None = None) -> Plant:
    """The plant of a mapping: an arm, or a linkage.

    Raises
    ------
    ModelError : a format, effect or key that this version does not know.
    ParameterError : a number that is not usable.
    """
    known = isinstance(mapping, Mapping) and mapping.get("format") == MODEL_FORMAT
    return (LinkagePlant if known and "mechanism" in mapping else Plant).from_mapping(mapping, where)


def load_model(path: str | os.PathLike[str]) -> Plant:
    """Read a model file; raises ModelError or ParameterError naming the file and the key."""
    return plant_of_mapping(read_yaml(path, ModelError), str(path))


def dump_model(plant: Plant, path: str | os.PathLike[str]) -> None:
    """Write a model file that loads to an equal plant; complete or not at all."""
    write_yaml(plant.to_mapping(), path, ModelError)
