# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Who listens to the simulator's states and who sends it commands."""

from collections.abc import Sequence
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node

#: names that a node has while its own are not known yet
UNKNOWN = "_NODE_NAME_UNKNOWN_"


class Peers:
    """Subscriptions to the states and publishers of commands, as the middleware finds and loses them.

    node : the simulator's; states, commands : full names of the topics.
    """

    def __init__(self, node: Node, states: str, commands: Sequence[str]) -> None:
        self._node, self._states, self._commands = node, states, tuple(commands)
        self._served: set[tuple[int, ...]] = set()
        self._publishers = dict.fromkeys(self._commands, 0)
        # subscriptions that there ever were, those of them that went, and those that were there for the last state
        self._joined = self._gone = self._sent_to = 0
        self._known = 0  # subscriptions that there ever were when `_served` was made
        self.lost = False  #: the last publisher of commands has gone since this was last set to False

    def state_events(self) -> PublisherEventCallbacks:
        """For the publisher of the states."""

        def matched(event: Any) -> None:
            self._joined, self._gone = event.total_count, event.total_count - event.current_count

        return PublisherEventCallbacks(matched=matched)

    def sent(self, subscriptions: int) -> None:
        """Take note that a state was sent, to so many subscriptions: events may tell of them later."""
        self._sent_to = subscriptions + self._gone

    @property
    def newcomer(self) -> bool:
        """Whether somebody subscribed to the states since the last one was sent."""
        return self._joined > self._sent_to

    def command_events(self, topic: str) -> SubscriptionEventCallbacks:
        """For the subscription of a topic of commands, its full name."""

        def matched(event: Any) -> None:
            self._publishers[topic] = event.current_count
            self.lost = event.current_count_change < 0 and not any(self._publishers.values())

        return SubscriptionEventCallbacks(matched=matched)

    @property
    def most_publishers(self) -> int:
        """The greatest number of publishers that one topic of commands has."""
        return max(self._publishers.values())

    def waits_for_a_state(self) -> bool | None:
        """Whether somebody subscribed since the last state who is to have it: a controller, or anybody where no
        controller is there that might answer a state twice; None as long as that cannot be told."""
        listeners = self._node.get_subscriptions_info_by_topic(self._states)
        senders = [info for topic in self._commands for info in self._node.get_publishers_info_by_topic(topic)]
        nodes = {(info.node_namespace, info.node_name) for info in senders}
        new = [info for info in listeners if tuple(info.endpoint_gid) not in self._served]
        if any(info.node_name == UNKNOWN for info in (*new, *senders)):
            return None
        return not nodes or any((info.node_namespace, info.node_name) in nodes for info in new)

    def all_served(self) -> None:
        """Those who listen now need not be sent the present state again."""
        if self._known != self._joined:
            found = self._node.get_subscriptions_info_by_topic(self._states)
            self._served, self._known = {tuple(info.endpoint_gid) for info in found}, self._joined
        self._sent_to = self._joined
