# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What real drives do beyond the thesis's model: one file an effect (see `base` for how to write one)."""

from puma_sim_core.effects.base import Effect, Kind, Parameter
from puma_sim_core.effects.registry import KINDS, load_effects, parse_effect

__all__ = ["KINDS", "VISCOUS", "Effect", "Kind", "Parameter", "load_effects", "parse_effect"]

#: the one effect that the thesis has: a parameter of every mechanism, which competes with all others
VISCOUS = KINDS["viscous_friction"]
