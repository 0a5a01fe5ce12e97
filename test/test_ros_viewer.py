# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The node `viewer` beside a `sim_node`: the arm in a browser moves, and the buttons reach the simulator."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from browser_support import needs_chromium

pytest.importorskip("rclpy")
pytest.importorskip("viser")
from devtools import Page, wait_for
from ros_support import Node, Peer, Program, arguments, run_program

pytestmark = needs_chromium
#: the answer to a button, as the page shows it
SAID = "(document.body.innerText.match(/{}: step (\\d+)/) || [])[1]"


@pytest.mark.long
def test_the_arm_of_a_simulator_is_seen_and_obeys_the_buttons(tmp_path):
    with Node(command_interface="position") as node, Peer(node.namespace, "position") as peer:
        peer.find_simulator(reset=False)
        words = [*arguments({"port": 0}), "-r", f"__ns:={node.namespace}"]
        with Program("puma_sim_ros.viewer", *words) as viewer:
            address = viewer.wait_for(r"http://127\.0\.0\.1:\d+")[0]
            with Page(address, tmp_path) as page:
                # a plot each of position, tracking error, voltage and current
                charts = "Object.values(window.__viserTestpoints?.uplots ?? {}).map((each) => each.chart)"
                page.wait(f"{charts}.length === 4")
                page.press("Pause")
                step = int(page.wait(SAID.format("Pause")))
                page.press("Step")
                assert int(page.wait(SAID.format("Step"))) == step + 1
                page.press("Reset")
                assert int(page.wait(SAID.format("Reset"))) == 0
                page.wait(f"{charts}[0].data[0].length < 3")
                early = page.wrists()
                page.press("Resume")
                page.wait(SAID.format("Resume"))
                shown = f"{charts}[0].data.slice(1).map((each) => each.at(-1))"

                def arrived() -> bool:
                    peer.send(1.0, -1.5, 2.0)
                    # in the plot [deg]
                    return np.allclose(page.value(shown), np.degrees(2 * [1.0, -1.5, 2.0]), atol=20.0)

                wait_for(arrived, "the pose that was commanded")
                page.press("Pause")
                page.wait(SAID.format("Pause"))
                assert abs(page.wrists() - early).sum() > 30
                allowed = (address, address.replace("http", "ws"), "data:", "blob:")
                assert all(request.startswith(allowed) for request in page.requests)


def test_a_port_that_is_taken_is_named():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        ran = run_program("puma_sim_ros.viewer", *arguments({"port": port}))
    assert ran.returncode == 2
    assert f"port {port}: cannot be listened on" in ran.stderr
