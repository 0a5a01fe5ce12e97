# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A chain of links and joints, as a URDF text describes it, and where its end is."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.errors import ModelError
from puma_sim_core.plant.plant import Plant

_TURNS, _SLIDES = ("revolute", "continuous"), ("prismatic",)
_GREY, _WHITE, _ORANGE = (89, 92, 97), (230, 230, 222), (219, 115, 36)
#: length of the carriage of a slide, of which no file says it [m]
_CARRIAGE = 0.12


class Shape(NamedTuple):
    """A box, cylinder or sphere of a link; numbers as in URDF."""

    form: str
    sizes: dict[str, tuple[float, ...]]  #: "size", "radius" or "length" [m]
    colour: tuple[int, int, int]  #: red, green, blue, each 0 to 255
    position: np.ndarray  #: (3,) [m]
    rotation: Rotation


class Joint(NamedTuple):
    """A joint and the link behind it."""

    name: str
    kind: str
    link: str
    position: np.ndarray  #: (3,) in the frame of the link before [m]
    rotation: Rotation
    axis: np.ndarray  #: (3,) in its own frame
    limits: tuple[float, float] | None  #: [rad or m]

    @property
    def moves(self) -> bool:
        """Whether it has a position."""
        return self.kind in (*_TURNS, *_SLIDES)

    def at(self, q: float | np.ndarray = 0.0) -> tuple[np.ndarray, Rotation]:
        """Position [m] and rotation of its link in the frame of the link before; q : one or (n,) [rad or m]."""
        along = np.multiply.outer(q, self.axis)
        if self.kind in _TURNS:
            return self.position, self.rotation * Rotation.from_rotvec(along)
        return self.position + self.rotation.apply(along if self.moves else 0.0 * along), self.rotation


@dataclass(frozen=True, eq=False)
class Chain:
    """Links one behind the other: the base, then a joint and its link, and so on."""

    base: str
    joints: tuple[Joint, ...]
    shapes: dict[str, tuple[Shape, ...]]  #: of each link

    @property
    def moving(self) -> tuple[Joint, ...]:
        """The joints that have a position, in order."""
        return tuple(joint for joint in self.joints if joint.moves)

    @property
    def size(self) -> float:
        """Length of the chain with its strokes stretched out [m]."""
        strokes = [np.ptp(joint.limits or 0.0) for joint in self.moving if joint.kind in _SLIDES]
        return float(sum(np.linalg.norm(joint.position) for joint in self.joints) + sum(strokes))

    @property
    def floor(self) -> float:
        """Height of the lowest end of an upright shape of the base [m]."""
        low = [
            s.position[2] - 0.5 * [*s.sizes.get("length", ()), *s.sizes.get("size", ())][-1]
            for s in self.shapes[self.base]
        ]
        return float(min(low, default=0.0))

    def end(self, q: np.ndarray) -> np.ndarray:
        """(n, 3) origin of the last link in the base [m]; q : (n, J) [rad or m]."""
        moving = iter(np.asarray(q, dtype=float).T)
        where, turned = np.zeros((len(q), 3)), Rotation.identity()
        for joint in self.joints:
            position, rotation = joint.at(next(moving) if joint.moves else 0.0)
            where, turned = where + turned.apply(position), turned * rotation
        return where


def chain_of_urdf(text: str) -> Chain:
    """The chain of a URDF text with shapes that are boxes, cylinders and spheres; other shapes are not drawn.

    Raises
    ------
    ModelError : no URDF, or links that are not one chain; names what.
    """
    try:
        robot = ElementTree.fromstring(text)
        colours = {m.get("name", ""): _colour(m) for m in robot.findall("material")}
        shapes = {
            link.get("name", ""): tuple(_shape(visual, colours) for visual in link.findall("visual"))
            for link in robot.findall("link")
        }
        after = {joint.find("parent").get("link"): joint for joint in robot.findall("joint")}  # type: ignore[union-attr]
        behind = {joint.find("child").get("link") for joint in after.values()}  # type: ignore[union-attr]
        (base,) = set(shapes) - behind
        joints, link = [], base
        while link in after:
            joints.append(_joint(after[link]))
            link = joints[-1].link
    except (ElementTree.ParseError, AttributeError, KeyError, ValueError, TypeError) as error:
        raise ModelError(f"cannot be drawn ({error})", where="URDF", expected="one chain of links") from None
    return Chain(base, tuple(joints), shapes)


def chain_of_plant(plant: Plant) -> Chain:
    """The chain of an arm, or of a machine of one joint.

    Raises ModelError: another machine.
    """
    if type(plant) is Plant:
        return chain_of_urdf(arm_urdf(plant.arm, inertias=False))
    if plant.joints == 1:
        return _one_joint_chain(plant.arm.joint_ranges[-1], plant.arm.d4 if plant.position_unit == "rad" else None)
    what, expected = f"'{plant.arm.name}' has {plant.joints} joints", "the arm, or a machine of one joint"
    raise ModelError(what, where="view", expected=expected)


def _numbers(element: ElementTree.Element | None, name: str, otherwise: str) -> np.ndarray:
    text = otherwise if element is None else element.get(name, otherwise)
    return np.array(text.split(), dtype=float)


def _origin(element: ElementTree.Element) -> tuple[np.ndarray, Rotation]:
    origin = element.find("origin")
    return _numbers(origin, "xyz", "0 0 0"), Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0"))


def _colour(material: ElementTree.Element) -> tuple[int, int, int]:
    red, green, blue = np.rint(255 * _numbers(material.find("color"), "rgba", "0.6 0.6 0.6 1")[:3]).astype(int).tolist()
    return red, green, blue


def _shape(visual: ElementTree.Element, colours: dict[str, tuple[int, int, int]]) -> Shape:
    (geometry,) = visual.findall("geometry/*")
    material = visual.find("material")
    colour = _GREY
    if material is not None:
        colour = _colour(material) if len(material) else colours[material.get("name", "")]
    names = ("size", "radius", "length")
    sizes = {name: tuple(_numbers(geometry, name, "").tolist()) for name in names if name in geometry.attrib}
    return Shape(geometry.tag, sizes, colour, *_origin(visual))


def _joint(element: ElementTree.Element) -> Joint:
    kind, limit = element.get("type", "fixed"), element.find("limit")
    limits = None if limit is None else (float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0)))
    axis, child = _numbers(element.find("axis"), "xyz", "1 0 0"), element.find("child")
    name, link = element.get("name", ""), "" if child is None else child.get("link", "")
    return Joint(name, kind, link, *_origin(element), axis, limits)


def _one_joint_chain(limits: tuple[float, float], length: float | None) -> Chain:
    """A lever of some length [m] that hangs down at q = 0; without one a carriage on a guide along x."""
    here, upright = np.zeros(3), Rotation.identity()
    if length is None:
        low, high = limits
        guide = (high - low + 2.0 * _CARRIAGE, 0.25 * _CARRIAGE, 0.25 * _CARRIAGE)
        below = np.array([0.5 * (low + high), 0.0, -0.5 * _CARRIAGE])
        fixed = Shape("box", {"size": guide}, _GREY, below, upright)
        carriage = (_CARRIAGE, 0.7 * _CARRIAGE, 0.5 * _CARRIAGE)
        moving: tuple[Shape, ...] = (Shape("box", {"size": carriage}, _ORANGE, here, upright),)
        joint, end = Joint("joint1", "prismatic", "link1", here, upright, np.array([1.0, 0.0, 0.0]), limits), here
    else:
        end, across = np.array([0.0, 0.0, -length]), Rotation.from_euler("x", np.pi / 2)
        fixed = Shape("cylinder", {"radius": (0.1 * length,), "length": (0.2 * length,)}, _GREY, here, across)
        moving = (
            Shape("cylinder", {"radius": (0.05 * length,), "length": (length,)}, _WHITE, 0.5 * end, upright),
            Shape("sphere", {"radius": (0.15 * length,)}, _ORANGE, end, upright),
        )
        joint = Joint("joint1", "revolute", "link1", here, upright, np.array([0.0, -1.0, 0.0]), limits)
    joints = (joint, Joint("end", "fixed", "end", end, upright, here, None))
    return Chain("base_link", joints, {"base_link": (fixed,), "link1": moving, "end": ()})
