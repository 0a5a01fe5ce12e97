# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The scene: arms with their links, ranges of the joints, the path of the wrist."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from puma_sim_core.pages.figure import COLOURS
from puma_sim_core.view.chain import Chain, Joint, Shape
from puma_sim_core.view.motion import ARM, LOOKS, MODEL, SETPOINT

#: points of a path; of a longer one every n-th is drawn
_PATH_POINTS = 1000
_RED = (200, 30, 40)
#: shares of a range between which it is drawn straight
_ARC = np.linspace(0.0, 1.0, 49)


def rgb(name: str) -> tuple[int, int, int]:
    """A colour of the figures as red, green and blue, each 0 to 255."""
    red, green, blue = bytes.fromhex(COLOURS[name][0][1:])
    return red, green, blue


class Scene:
    """Arms on a floor: the one that moved, a ghost at its setpoint, the model beside it.

    server : of viser; arms : positions (n, J) [rad or m] by the names of `Motion.arms`, whose paths are drawn.
    """

    def __init__(self, server: Any, chain: Chain, arms: Mapping[str, np.ndarray]) -> None:
        self._scene, self._chain = server.scene, chain
        self._size = size = chain.size
        self._shown: dict[str, list[Any]] = {}
        self._needles: list[Any] = []
        self._beyond = [False] * len(chain.moving)
        with server.atomic():
            self._scene.configure_default_lights(cast_shadow=False)
            for name in arms:
                self._add(name, 1.5 * size if name == MODEL else 0.0, labelled=MODEL in arms)
            ends = [self.draw_path(name, positions) for name, positions in arms.items()]
            self._limits()
            floor = min(chain.floor, *(float(end[:, 2].min()) for end in ends))
            width = 5.0 * size
            self._scene.add_grid(
                "/floor", width, width, cell_size=0.1 * width, section_size=0.1 * width, position=(0.0, 0.0, floor)
            )
            self.show({name: positions[0] for name, positions in arms.items()})
        # of two arms from ahead, so that both are seen alike
        middle, way = ((0.2, 0.75, -0.15), (2.4, 0.4, 0.8)) if MODEL in arms else ((0.2, 0.0, -0.15), (1.3, 1.6, 0.75))
        server.initial_camera.look_at = size * np.array(middle)
        server.initial_camera.position = size * np.add(middle, way)

    def show(self, positions: Mapping[str, np.ndarray]) -> None:
        """Move each arm to its positions (J,) [rad or m]; the needle of a joint beyond its range turns red."""
        for name, q in positions.items():
            for frame, joint, value in zip(self._shown[name], self._chain.moving, q):
                position, rotation = joint.at(float(value))
                frame.position, frame.wxyz = position, _wxyz(rotation)
        for k, (joint, value) in enumerate(zip(self._chain.moving, positions[ARM])):
            low, high = joint.limits or (-np.inf, np.inf)
            if self._beyond[k] != (beyond := not low <= value <= high):
                self._beyond[k] = beyond
                self._needles[k].colors = np.full((1, 2, 3), _RED if beyond else rgb("ink"), np.uint8)

    def draw_path(self, name: str, positions: np.ndarray) -> np.ndarray:
        """Draw the way of the end of an arm; positions (n, J). Returns its points (n, 3) in the arm's base [m]."""
        points = self._chain.end(positions)
        thin = points[:: -(-len(points) // _PATH_POINTS)]
        # of one point, too: it takes the place of an earlier path
        segments = np.stack([thin, [*thin[1:], points[-1]]], axis=1).astype(np.float32)
        colour = rgb(LOOKS[name].get("colour", "blue"))
        self._scene.add_line_segments(f"/{name}/path", segments, colour, thickness=0.006 * self._size)
        return points

    def _add(self, name: str, offset: float, labelled: bool) -> None:
        """An arm whose base is moved along y by `offset` [m]."""
        ghost, path = name == SETPOINT, f"/{name}"
        self._scene.add_frame(path, show_axes=False, position=(0.0, offset, 0.0))
        if labelled and not ghost:
            words = {ARM: "measured"}.get(name, name)
            self._scene.add_label(f"{path}/label", words, position=(0.3 * self._size, 0.0, self._chain.floor))
        if not ghost:
            self._shapes(path, self._chain.shapes[self._chain.base])
        frames = []
        for joint in self._chain.joints:
            path = f"{path}/{joint.link}"
            position, rotation = joint.at()
            frame = self._scene.add_frame(path, show_axes=False, position=position, wxyz=_wxyz(rotation))
            frames += [frame] if joint.moves else []
            self._shapes(path, self._chain.shapes[joint.link], ghost)
        self._shown[name] = frames

    def _shapes(self, path: str, shapes: tuple[Shape, ...], ghost: bool = False) -> None:
        for k, shape in enumerate(shapes):
            name, place = f"{path}/shape{k}", {"position": shape.position, "wxyz": _wxyz(shape.rotation)}
            look = {"color": rgb("yellow"), "opacity": 0.25, "scale": 1.04} if ghost else {"color": shape.colour}
            if shape.form == "box":
                self._scene.add_box(name, dimensions=shape.sizes["size"], **look, **place)
            elif shape.form == "cylinder":
                (radius,), (length,) = shape.sizes["radius"], shape.sizes["length"]
                self._scene.add_cylinder(name, radius=radius, height=length, **look, **place)
            elif shape.form == "sphere":
                self._scene.add_icosphere(name, radius=shape.sizes["radius"][0], **look, **place)

    def _limits(self) -> None:
        """The range of each joint, and a needle at its position."""
        path = f"/{ARM}"
        moving = self._chain.moving
        for joint in self._chain.joints:
            before, path = path, f"{path}/{joint.link}"
            if joint not in moving or joint.limits is None:
                continue
            radius = 0.24 * self._size
            points, needle = _range(joint, radius)
            thick = {"thickness": 0.006 * self._size}
            place = {"position": joint.position, "wxyz": _wxyz(joint.rotation)}
            self._scene.add_line_segments(f"{before}/range_{joint.name}", points, rgb("green"), **thick, **place)
            self._needles.append(self._scene.add_line_segments(f"{path}/needle", needle, rgb("ink"), **thick))


def _wxyz(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1)


def _range(joint: Joint, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Segments (m, 2, 3) of a joint's range before it, and of a needle (1, 2, 3) that moves with it [m]."""
    low, high = joint.limits or (0.0, 0.0)
    reach = low + (high - low) * _ARC
    across = np.eye(3)[int(np.argmin(np.abs(joint.axis)))]
    if joint.kind == "prismatic":
        line, needle = np.multiply.outer(reach, joint.axis), np.stack([0.0 * across, 0.5 * radius * across])
        ends = [[line[k], line[k] + 0.5 * radius * across] for k in (0, -1)]
    else:
        line = Rotation.from_rotvec(np.multiply.outer(reach, joint.axis)).apply(radius * across)
        needle = np.stack([0.6 * radius * across, 1.1 * radius * across])
        ends = [[0.85 * line[k], 1.15 * line[k]] for k in (0, -1)]
    segments = np.concatenate([np.stack([line[:-1], line[1:]], axis=1), ends])
    return segments.astype(np.float32), needle[None].astype(np.float32)
