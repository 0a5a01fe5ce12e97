# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Names of tasks, measures and perturbations as a reader of the page sees them."""

from puma_sim_core.effects import KINDS
from puma_sim_core.pages.text import effect_name, place


def words(name: str, lower: bool = True) -> str:
    """A task, measure or perturbation in words; of a single effect with its place and size."""
    base, *where = name.split(":")
    if base not in KINDS:
        return name.replace("_", " ")
    joint, size = next((each for each in where if each.isdigit()), None), where[-1] if where else ""
    found = effect_name(base, lower) + (f" on {place(int(joint))}" if joint else "")
    return found if size in ("", joint) else f"{found}, {size}"
