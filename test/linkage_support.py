# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Linkages that several tests make, and their torques by a derivation of its own: point masses in space."""

from __future__ import annotations

from math import pi

import numpy as np

from puma_sim_core.plant.linkage.linkage_file import read_linkage
from puma_sim_core.plant.linkage.linkage_mechanism import LinkageMechanism
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT

#: mass, length, centre, across, beside [kg, m], and inertia, along, across [kg m^2] of the links
NUMBERS = {
    "shoulder": {
        "mass": 1.3,
        "length": 0.4,
        "centre": 0.25,
        "across": 0.03,
        "beside": 0.11,
        "inertia": 0.02,
        "inertia_along": 0.006,
        "inertia_across": 0.017,
    },
    "elbow": {
        "mass": 0.8,
        "centre": 0.17,
        "across": -0.02,
        "beside": 0.07,
        "inertia": 0.01,
        "inertia_along": 0.004,
        "inertia_across": 0.008,
    },
    "base": {"inertia": 0.05},
}
UNITS = {"mass": "kg", "length": "m", "centre": "m", "across": "m", "beside": "m"}


def known(value, unit):
    return {"value": value, "unit": unit, "known": True}


def passive(viscous=0.0, inertia=0.0):
    return {
        "amplifier": "none",
        "motor_inertia": known(inertia, "kg.m^2"),
        "viscous_friction": known(viscous, "N.m.s/rad"),
    }


def torque_drive(viscous=0.0, inertia=0.0):
    return {**passive(viscous, inertia), "amplifier": "torque"}


def link(place, upright, elbow, **numbers):
    """The entry of a link, without what does not count."""
    left = {"beside", "inertia_along", "inertia_across"} if not upright and place != "base" else set()
    left |= set() if elbow else {"length"}
    own = {name: value for name, value in {**NUMBERS[place], **numbers}.items() if name not in left}
    return {name: known(value, UNITS.get(name, "kg.m^2")) for name, value in own.items()}


def linkage(name="test", gravity=9.81, zero=None, numbers=None, **axes):
    """A linkage; axes : "base" and others, each a drive or an angle [rad] at which it is held; zero : of axes, each a
    number or (number, standard deviation) [rad]."""
    zero, numbers = zero or {}, numbers or {}
    upright = "base" in axes and isinstance(axes["base"], dict)
    mapping = {"format": MECHANISM_FORMAT, "name": name, "kind": "linkage", "gravity": known(gravity, "m/s^2")}
    for place, given in axes.items():
        entry = {"link": link(place, upright, "elbow" in axes, **numbers.get(place, {}))}
        if place in zero:
            value, *deviation = np.atleast_1d(zero[place]).tolist()
            entry["zero"] = {"value": value, "unit": "rad", **({"deviation": deviation[0]} if deviation else {})}
        if isinstance(given, dict):
            entry |= {"range": {"value": [-7.0, 7.0], "unit": "rad"}, "torque_scale": {"value": 0.2, "unit": "N.m"}}
            entry["drive"] = given
        else:
            entry["held"] = {"value": given, "unit": "rad"}
        mapping[place] = entry
    return read_linkage(mapping)


def mechanism(**given):
    return LinkageMechanism.of(linkage(**given))


def plant(effects=(), **given):
    return LinkagePlant.of(linkage(**given), effects)


class PointMasses:
    """A linkage as masses on three crossed rods a link, by rotations in space.

    The base turns about z, which is upright, and the others about y where the base is at 0, right-handed all; at angle
    0 a link hangs down. What is beside the plane of motion is along y.
    """

    def __init__(self, body):
        self.body = body

    def masses(self, place):
        """(mass, along, across, beside) of the points of a link about its centre of mass, and its centre."""
        v = self.body.numbers(self.body.values, place)
        own, along, across = v["inertia"], v["inertia_along"], v["inertia_across"]
        # integrals of the squares of the three coordinates
        squares = 0.5 * np.array([own + across - along, own + along - across, along + across - own])
        if not self.body.turns("base"):
            squares = np.array([own, 0.0, 0.0])
        points = []
        for n, square in enumerate(squares):
            arm = np.zeros(3)
            # a sixth of the mass at each end; negative squares cannot be
            arm[n] = np.sqrt(3.0 * square / v["mass"])
            points += [(v["mass"] / 6.0, arm), (v["mass"] / 6.0, -arm)]
        centre = np.array([v["centre"], v["across"], v["beside"] if self.body.turns("base") else 0.0])
        return [(m, centre + arm) for m, arm in points], v["length"]

    def places(self, q):
        """(k,) masses and (k, 3) positions in space for the positions (J,) of the joints that move."""
        left = list(q)
        angle = {a.place: (left.pop(0) if a.moves else a.held) + a.zero for a in self.body.axes}
        turn = angle.get("base", 0.0)
        joint, psi, found = np.zeros(3), 0.0, []
        for place in ("shoulder", "elbow"):
            if place not in angle:
                continue
            psi = psi + angle[place]
            along = np.array([-np.sin(psi), 0.0, -np.cos(psi)])
            across = np.array([-np.cos(psi), 0.0, np.sin(psi)])
            points, length = self.masses(place)
            for mass, (a, b, c) in points:
                found.append((mass, joint + a * along + b * across + c * np.array([0.0, 1.0, 0.0])))
            joint = joint + length * along
        c, s = np.cos(turn), np.sin(turn)
        spun = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.array([m for m, _ in found]), np.array([spun @ p for _, p in found])

    def torque(self, q, qd, qdd, gravity=9.81):
        """(J,) torques of d'Alembert's principle: sum of m (a + g) . dp/dq."""
        q, qd, qdd = (np.asarray(v, dtype=float) for v in (q, qd, qdd))
        mass, place = self.places(q)
        columns = []
        for n in range(len(q)):
            step = np.zeros(len(q), dtype=complex)
            step[n] = 1e-30j
            columns.append(np.imag(self.places(q + step)[1]) / 1e-30)
        jacobian = np.stack(columns, axis=-1)
        h = 1e-3
        bend = (self.places(q + h * qd)[1] - 2.0 * place + self.places(q - h * qd)[1]) / h**2
        further = (self.places(q + 2 * h * qd)[1] - 2.0 * place + self.places(q - 2 * h * qd)[1]) / (2 * h) ** 2
        acceleration = jacobian @ qdd + (4.0 * bend - further) / 3.0
        acceleration[:, 2] += gravity
        out = np.einsum("k,ki,kij->j", mass, acceleration, jacobian)
        base = self.body.axis("base")
        if base is not None and base.moves:
            out[0] += self.body.numbers(self.body.values, "base")["inertia"] * qdd[0]
        return out


LEVEL_UP, LEVEL_DOWN = 0.5 * pi, -0.5 * pi
