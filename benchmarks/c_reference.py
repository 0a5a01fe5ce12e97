# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The same equations as a C program would have them, compiled here and now with ``cc -O3``.

The equations were written for this file from the 20 constants of `rigid_body.Lumps` by
Lagrange's equations, not taken over from the kernel, so that the C is also a check of it. Like
the kernel it makes a whole run in one call and stores the state of every step.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.task import STEP, Row, Task, Unavailable

SOURCE = r"""
#include <math.h>
#include <string.h>

/* the 20 constants of the rigid body, in the order of the table that is passed in */
typedef struct {
    double A0, A1, A2, A3, A4, A5, A6, B1, B2, B3, B4, E0, E1, E2, E3, E4, g1, g2, g3, g4;
} Body;

/* one motor: 1/L, R, back-EMF and torque per ampere at the joint, viscous friction */
typedef struct { double inverse_inductance, resistance, emf, torque, viscous; } Motor;

/* x = (q, qd, i); v held; dx = time derivative of x */
static inline __attribute__((always_inline)) void derivative(
    const double *x, const double *v, const Body *b, const Motor *motor, double *dx)
{
    const double w1 = x[3], w2 = x[4], w3 = x[5];
    const double s2 = sin(x[1]), c2 = cos(x[1]);
    const double su = sin(x[1] + x[2]), cu = cos(x[1] + x[2]);
    const double s3 = su * c2 - cu * s2, c3 = cu * c2 + su * s2;

    /* inertia */
    const double h = b->E1 * c3 + b->E2 * s3;
    const double m13 = b->B1 * su + b->B2 * cu;
    const double m12 = b->B3 * s2 + b->B4 * c2 + m13;
    const double m11 = b->A0 + c2 * (b->A1 * c2 + b->A2 * s2 + b->A5 * cu + b->A6 * su)
                     + cu * (b->A3 * cu + b->A4 * su);
    const double m22 = b->E3 + 2.0 * h;
    const double m23 = b->E0 + h;
    const double m33 = b->E4;

    /* its derivatives: of D11 to q3 and q2, of D13 to either, of D12 to q2, of h to q3 */
    const double d11_3 = 2.0 * cu * (b->A4 * cu - b->A3 * su) - b->A4
                       + c2 * (b->A6 * cu - b->A5 * su);
    const double d11_2 = 2.0 * c2 * (b->A2 * c2 - b->A1 * s2) - b->A2
                       - s2 * (b->A5 * cu + b->A6 * su) + d11_3;
    const double d13 = b->B1 * cu - b->B2 * su;
    const double d12_2 = b->B3 * c2 - b->B4 * s2 + d13;
    const double h_3 = b->E2 * c3 - b->E1 * s3;

    /* torque of the motors less Coriolis, centripetal and gravity torques */
    const double pull3 = b->g1 * cu + b->g2 * su;
    const double pull2 = b->g3 * c2 + b->g4 * s2 + pull3;
    const double bend = w3 * (2.0 * w2 + w3);
    const double r1 = motor[0].torque * x[6] - motor[0].viscous * w1
                    - w1 * (d11_2 * w2 + d11_3 * w3) - d12_2 * w2 * w2 - d13 * bend;
    const double r2 = motor[1].torque * x[7] - motor[1].viscous * w2
                    - h_3 * bend + 0.5 * d11_2 * w1 * w1 - pull2;
    const double r3 = motor[2].torque * x[8] - motor[2].viscous * w3
                    + h_3 * w2 * w2 + 0.5 * d11_3 * w1 * w1 - pull3;

    /* inverse of the symmetric matrix by its cofactors */
    const double k11 = m22 * m33 - m23 * m23;
    const double k12 = m13 * m23 - m12 * m33;
    const double k13 = m12 * m23 - m13 * m22;
    const double k22 = m11 * m33 - m13 * m13;
    const double k23 = m12 * m13 - m11 * m23;
    const double k33 = m11 * m22 - m12 * m12;
    const double scale = 1.0 / (m11 * k11 + m12 * k12 + m13 * k13);

    dx[0] = w1;
    dx[1] = w2;
    dx[2] = w3;
    dx[3] = scale * (k11 * r1 + k12 * r2 + k13 * r3);
    dx[4] = scale * (k12 * r1 + k22 * r2 + k23 * r3);
    dx[5] = scale * (k13 * r1 + k23 * r2 + k33 * r3);
    for (int j = 0; j < 3; j++)
        dx[6 + j] = motor[j].inverse_inductance
                  * (v[j] - motor[j].resistance * x[6 + j] - motor[j].emf * x[3 + j]);
}

/* out: (steps + 1) rows of 9, the first of which is the start */
void run(const double *start, const double *volts, long steps, double step, const Body *body,
         const Motor *motor, double *out)
{
    double x[9], y[9], k1[9], k2[9], k3[9], k4[9];
    memcpy(x, start, sizeof x);
    memcpy(out, x, sizeof x);
    for (long n = 0; n < steps; n++) {
        const double *v = volts + 3 * n;
        derivative(x, v, body, motor, k1);
        for (int j = 0; j < 9; j++) y[j] = x[j] + 0.5 * step * k1[j];
        derivative(y, v, body, motor, k2);
        for (int j = 0; j < 9; j++) y[j] = x[j] + 0.5 * step * k2[j];
        derivative(y, v, body, motor, k3);
        for (int j = 0; j < 9; j++) y[j] = x[j] + step * k3[j];
        derivative(y, v, body, motor, k4);
        for (int j = 0; j < 9; j++)
            x[j] += step / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j]);
        memcpy(out + 9 * (n + 1), x, sizeof x);
    }
}
"""

LABEL = "the same equations in C, -O3"
LABEL_ALL_CORES = f"{LABEL}, on all cores"

#: runs of one core in a row, so that starting threads does not count
_REPETITIONS = 8

_DOUBLES = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")


def compiler() -> str | None:
    """The C compiler: ``$CC``, or cc, gcc or clang on the path; None where there is none."""
    for candidate in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if candidate and shutil.which(shlex.split(candidate)[0]):
            return candidate
    return None


def build(source: str, flags: tuple[str, ...], folder: Path) -> Path:
    """Compile the C `source` to a shared library in `folder`; its path.

    Raises
    ------
    Unavailable : without a compiler, or when it fails.
    """
    cc = compiler()
    if cc is None:
        raise Unavailable("no C compiler")
    text, library = folder / "source.c", folder / "library.so"
    text.write_text(source, encoding="utf-8")
    done = subprocess.run(
        [*shlex.split(cc), *flags, "-fPIC", "-shared", str(text), "-o", str(library), "-lm"],
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["it gave no reason"])[0]
        raise Unavailable(f"{cc} {' '.join(flags)} failed: {reason}")
    return library


class CReference:
    """The compiled C; ``flags`` go to the compiler. Raises Unavailable."""

    def __init__(self, flags: tuple[str, ...] = ("-O3",)):
        with tempfile.TemporaryDirectory(prefix="puma-sim-bench-") as folder:
            self._run = ctypes.CDLL(str(build(SOURCE, flags, Path(folder)))).run
        self._run.argtypes = [_DOUBLES, _DOUBLES, ctypes.c_long, ctypes.c_double, _DOUBLES, _DOUBLES, _DOUBLES]
        self._run.restype = None

    def prepared(self, task: Task) -> Callable[[], np.ndarray]:
        """A function of no arguments that gives the states at all steps, (n + 1, 9), as in `Task`.

        It fills the same array each time.
        """
        body, drive = task.plant.constants.body, task.plant.constants.drive
        out = np.empty((task.steps + 1, 9))
        arguments = (
            np.ascontiguousarray(task.state, float),
            np.ascontiguousarray(task.voltages, float),
            task.steps,
            STEP,
            np.array(body),
            np.array(drive),
            out,
        )

        def run():
            self._run(*arguments)
            return out

        return run


def on_all_cores(task: Task, cores: int) -> Row:
    """Each core its own runs, at the same time: what this machine gives to more than one core."""
    runs = [CReference().prepared(task) for _ in range(cores)]

    def repeat(run):
        for _ in range(_REPETITIONS):
            last = run()
        return last[-1, :3].copy()

    def together():
        with ThreadPoolExecutor(cores) as executor:
            return next(iter(executor.map(repeat, runs)))

    return Row(
        LABEL_ALL_CORES,
        together,
        cores * _REPETITIONS * task.seconds,
        task.seconds,
        calls=5,
        note="time a run, with a run on each core all the while",
    )


def rows(task: Task, cores: int = 1) -> list[Row]:
    """C at -O3, with the instructions of this very machine, and on all cores.

    Raises Unavailable without a compiler.
    """
    made = []
    for flags in (("-O3",), ("-O3", "-march=native")):
        try:
            reference = CReference(flags)
        except Unavailable:
            if not made:
                raise
            continue  # some compilers refuse -march=native
        made.append(
            Row(
                LABEL.replace("-O3", " ".join(flags)),
                lambda run=reference.prepared(task): run()[-1, :3].copy(),
                task.seconds,
                calls=9,
            )
        )
    if cores > 1:
        made.append(on_all_cores(task, cores))
    return made
