# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""CasADi: our own expressions as its graph, RK4 step and all steps of the run, as generated C."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.c_reference import build
from benchmarks.task import STEP, Row, Task

PACKAGES = ("casadi",)


def step_function(task: Task):
    """One RK4 step as a CasADi function (state (9), volts (3)) -> state (9)."""
    import casadi as ca

    k, drive = task.plant.constants.body, task.plant.constants.drive
    rate, resistance, emf, torque, viscous = (ca.DM(list(drive[j::5])) for j in range(5))

    def inertia(q):
        s2, c2, s3, c3 = ca.sin(q[1]), ca.cos(q[1]), ca.sin(q[2]), ca.cos(q[2])
        su, cu = ca.sin(q[1] + q[2]), ca.cos(q[1] + q[2])
        m13 = k.B1 * su + k.B2 * cu
        m12 = k.B3 * s2 + k.B4 * c2 + m13
        h = k.E1 * c3 + k.E2 * s3
        m11 = k.A0 + k.A1 * c2 * c2 + k.A2 * s2 * c2 + k.A3 * cu * cu + k.A4 * su * cu + k.A5 * c2 * cu + k.A6 * c2 * su
        return ca.vertcat(
            ca.horzcat(m11, m12, m13), ca.horzcat(m12, k.E3 + 2 * h, k.E0 + h), ca.horzcat(m13, k.E0 + h, k.E4)
        )

    def gravity(q):
        c2, s2 = ca.cos(q[1]), ca.sin(q[1])
        fore = k.g1 * ca.cos(q[1] + q[2]) + k.g2 * ca.sin(q[1] + q[2])
        return ca.vertcat(0, k.g3 * c2 + k.g4 * s2 + fore, fore)

    q, w, i, volts = (ca.SX.sym(name, 3) for name in ("q", "w", "i", "v"))
    M = inertia(q)
    momentum = M @ w
    # Lagrange: d/dt (M w) - (1/2) d(w' M w)/dq, the first at constant w
    coriolis = ca.jtimes(momentum, q, w) - 0.5 * ca.gradient(ca.dot(w, momentum), q)
    factor, transposed, order = ca.ldl(M, False)
    qdd = ca.ldl_solve(torque * i - viscous * w - coriolis - gravity(q), factor, transposed, order)
    slope = ca.Function(
        "slope", [ca.vertcat(q, w, i), volts], [ca.vertcat(w, qdd, rate * (volts - resistance * i - emf * w))]
    )

    x = ca.MX.sym("x", 9)
    v = ca.MX.sym("v", 3)
    k1 = slope(x, v)
    k2 = slope(x + 0.5 * STEP * k1, v)
    k3 = slope(x + 0.5 * STEP * k2, v)
    k4 = slope(x + STEP * k3, v)
    # expanded into scalar operations: the fastest form of those that were tried
    return ca.Function("step", [x, v], [x + STEP / 6 * (k1 + 2 * (k2 + k3) + k4)], ["x", "v"], ["x_next"]).expand()


def rows(task: Task) -> list[Row]:
    """The whole run as one call of generated C. Raises Unavailable without a compiler."""
    import casadi as ca

    whole = step_function(task).mapaccum("whole", task.steps)
    generator = ca.CodeGenerator("whole.c")
    generator.add(whole)
    with tempfile.TemporaryDirectory(prefix="puma-sim-bench-") as folder:
        library = build(generator.dump(), ("-O3",), Path(folder))
        run = ca.external(whole.name(), str(library))
    volts = np.ascontiguousarray(task.voltages.T)

    def generated():
        return np.asarray(run(task.state, volts))[:3, -1]

    return [Row("CasADi, generated C of our expressions", generated, task.seconds, calls=3)]
