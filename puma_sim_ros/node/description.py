# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A session as texts: its model and its URDF, as the node publishes and records them."""

import yaml
from rclpy.node import Node

from puma_sim_core.plant.urdf import plant_urdf
from puma_sim_core.recording.topics import other_names
from puma_sim_core.simulation.session_config import SessionConfig


class Description:
    """Writes the texts. Those of the last session are kept: to write them takes longer than many steps.

    node : gives the names of the topics; inertias : whether the URDF has masses and inertias.
    """

    def __init__(self, node: Node, inertias: bool) -> None:
        self._node, self._inertias = node, inertias
        self._last: tuple[SessionConfig, tuple[str, str]] | None = None

    def texts(self, config: SessionConfig) -> tuple[str, str]:
        """Model, as YAML, and URDF of a session."""
        if self._last is None or self._last[0] != config:
            self._last = config, self._written(config)
        return self._last[1]

    def _written(self, config: SessionConfig) -> tuple[str, str]:
        node = self._node
        # `sim_node/` stands for the node's own name
        names = other_names(node.get_namespace(), lambda name: node.resolve_topic_name(name.replace("sim_node/", "~/")))
        mapping = {**config.to_mapping(), **({"topics": names} if names else {})}
        links = (config.joint_names, config.frame_id)
        urdf = plant_urdf(config.plant, *links, config.voltage_limit, inertias=self._inertias)
        return yaml.safe_dump(mapping, sort_keys=False), urdf
