# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A plant as URDF text: its arm with what it carries, and the friction that URDF knows."""

from collections.abc import Sequence

from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.plant.plant import Plant


def plant_urdf(
    plant: Plant,
    joint_names: Sequence[str] = ("joint1", "joint2", "joint3"),
    base_link: str = "base_link",
    voltage_limit: float = 40.0,
    *,
    inertias: bool = True,
) -> str:
    """URDF of a plant; arguments of `arm_urdf`.

    Payloads are in the inertias; viscous and Coulomb friction stand in ``dynamics``. URDF has no
    words for the other effects.
    """
    dry = {e.joint: e.values["torque"] for e in plant.effects if e.kind.name == "coulomb_friction"}
    friction = [dry.get(joint, 0.0) for joint in (1, 2, 3)]
    return arm_urdf(
        plant.loaded_arm,
        joint_names,
        base_link,
        voltage_limit,
        inertias=inertias,
        damping=plant.viscous_friction,
        friction=friction,
    )
