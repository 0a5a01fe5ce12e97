# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The picture of the demonstration: the arm from the side, and its joints over time."""

from __future__ import annotations

from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.kinematics import elbow_position, wrist_position
from puma_sim_core.pages.figure import COLOURS
from puma_sim_core.recording.bag import BagContents
from puma_sim_core.recording.recording import Recording

_LIGHT = {name: light for name, (light, _) in COLOURS.items()}
_JOINT_COLOURS = [_LIGHT[name] for name in ("blue", "orange", "green")]
_INK, _PALE = _LIGHT["ink"], _LIGHT["line"]
_STYLE = {
    "font.size": 9,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "text.color": _INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def draw_motion(bag: BagContents, table: Recording, arm: ArmParameters, path: Path) -> None:
    """Draw the arm on its way and the joints' angles, errors and voltages to a PNG file.

    bag : the recorded session; table : what the controller noted (setpoints, positions [rad],
    voltages [V] over time [s]); arm : for the lengths of the links.
    """
    with matplotlib.style.context(["default", _STYLE]):
        figure = Figure(figsize=(11.0, 6.6), layout="constrained")
        grid = figure.add_gridspec(3, 2, width_ratios=(0.8, 1.0))
        _draw_arm(figure.add_subplot(grid[:, 0]), table, arm)
        _draw_joints([figure.add_subplot(grid[row, 1]) for row in range(3)], bag, table)
        figure.suptitle("PUMA 560 down a vertical line: PID in volts over ROS 2 topics", fontsize=12)
        figure.savefig(path, format="png", dpi=130)


def _draw_arm(ax: Axes, table: Recording, arm: ArmParameters) -> None:
    """The arm at equal times, seen along y0; the path of the wrist and the line it should go."""
    ax.plot([0, 0], [-0.672, 0], color=_PALE, lw=16, solid_capstyle="butt", zorder=1)
    ax.plot([-0.17, 0.17], [-0.672, -0.672], color=_PALE, lw=6, zorder=1)
    rows = np.linspace(0, len(table) - 1, 7).round().astype(int)
    for place, row in enumerate(rows):
        q = table.position[row]
        joints = np.array([np.zeros(3), elbow_position(q, arm), wrist_position(q, arm)])
        last = place == len(rows) - 1
        shade = _INK if last else matplotlib.colormaps["Greys"](0.2 + 0.07 * place)
        ax.plot(joints[:, 0], joints[:, 2], color=shade, lw=8 if last else 5, solid_capstyle="round", zorder=2 + place)
        ax.plot(*joints[1, [0, 2]], "o", color="white", ms=4 if last else 3, zorder=2 + place)
    ax.plot(0.0, 0.0, "o", color="white", ms=4, zorder=10)
    wanted = np.array([wrist_position(q, arm) for q in table.setpoint])
    gone = np.array([wrist_position(q, arm) for q in table.position])
    ax.plot(
        wanted[:, 0], wanted[:, 2], color=_LIGHT["yellow"], lw=5, alpha=0.6, zorder=20, label="setpoints of the wrist"
    )
    ax.plot(gone[:, 0], gone[:, 2], color=_LIGHT["purple"], lw=1.3, zorder=21, label="wrist")
    ax.plot(*gone[-1, [0, 2]], "o", color=_LIGHT["purple"], ms=5, zorder=22)
    apart = 1e3 * np.linalg.norm(gone - wanted, axis=1).max()
    ax.set_title(f"from the side; never more than {apart:.1f} mm from the setpoints", fontsize=9)
    ax.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", xlim=(-0.25, 0.65), ylim=(-0.72, 0.52))
    ax.legend(loc="lower right")


def _draw_joints(axes: list[Axes], bag: BagContents, table: Recording) -> None:
    """Angles with setpoints, tracking errors, voltages."""
    angle, error, volts = axes
    time = bag.time_ns * 1e-9
    for j, colour in enumerate(_JOINT_COLOURS):
        angle.plot(table.time, np.degrees(table.setpoint[:, j]), color=colour, lw=4, alpha=0.3)
        angle.plot(time, np.degrees(bag.position[:, j]), color=colour, lw=1.2, label=f"joint {j + 1}")
        error.plot(table.time, np.degrees(table.setpoint[:, j] - table.position[:, j]), color=colour, lw=1.2)
        # a voltage holds over the step that led to its state
        volts.step(time, bag.voltage[:, j], where="pre", color=colour, lw=1.0)
    angle.set_ylabel("angle [deg]")
    angle.legend(loc="upper left", ncols=3)
    error.set_ylabel("tracking error [deg]")
    volts.set_ylabel("motor voltage [V]")
    volts.set_xlabel("simulated time [s]")
    for ax in axes:
        ax.axhline(0.0, color=_PALE, lw=0.8, zorder=0)
        ax.set_xlim(0.0, table.time[-1])
    for ax in axes[:2]:
        ax.tick_params(labelbottom=False)
