# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Where the numbers of a lane stand in the flat array of a group that follows a motion, and what reads and writes them.

Number k of lane m stands at k * LANES + m. The first are those of `lanes`: state, voltages, body and drive.
"""

from collections.abc import Callable
from typing import Any

from puma_sim_core.dynamics.lanes import LANE_NUMBERS, in_lane
from puma_sim_core.dynamics.types import Drive, Model
from puma_sim_core.jit import written

#: what stays the same over a run: levels of friction in positive and in negative direction [N.m], 1.0 where a joint has
#: dry friction, currents that are near their limit [A], and viscous friction with the back-EMF of motors without
#: inductance in it (`circuit.with_damping`)
LEVELS, HAS_DRY, NEAR_LIMIT, DAMPING = (LANE_NUMBERS + n for n in (0, 6, 9, 12))
#: the state at the start of a row, and 1.0 where the row is to be taken again
BEFORE, ALONE = LANE_NUMBERS + 15, LANE_NUMBERS + 24
#: of a step with effects: drive, slip, and of a stage trig, torques, state, derivative, and the sum of derivatives
STEP_DRIVE, SLIP, TRIG, TORQUE, STAGE, RATE, SUM = (ALONE + 1 + n for n in (0, 15, 21, 25, 28, 37, 46))
#: numbers of one lane
FOLLOWED = SUM + 9


def _reader(first: int, count: int) -> Callable[..., Any]:
    """(a, m) -> as many numbers of lane m."""
    return written("read", "a, m", [f"return ({', '.join(in_lane(first, count))})"], {})


def _writer(first: int, count: int) -> Callable[..., Any]:
    """(a, m, y) puts as many numbers in lane m."""
    return written("write", "a, m, y", [f"{place} = y[{k}]" for k, place in enumerate(in_lane(first, count))], {})


state_of, put_state = _reader(0, 9), _writer(0, 9)
volts_of, put_volts = _reader(9, 3), _writer(9, 3)
body_of, drive_of = _reader(12, 20), _reader(32, 15)
levels_of, has_dry_of, near_limit_of, damping_of = (
    _reader(LEVELS, 6),
    _reader(HAS_DRY, 3),
    _reader(NEAR_LIMIT, 3),
    _reader(DAMPING, 3),
)
before_of, put_before = _reader(BEFORE, 9), _writer(BEFORE, 9)
step_drive_of, put_step_drive = _reader(STEP_DRIVE, 15), _writer(STEP_DRIVE, 15)
slip_of, put_slip = _reader(SLIP, 6), _writer(SLIP, 6)
trig_of, put_trig = _reader(TRIG, 4), _writer(TRIG, 4)
torque_of, put_torque = _reader(TORQUE, 3), _writer(TORQUE, 3)
stage_of, put_stage = _reader(STAGE, 9), _writer(STAGE, 9)
rate_of, put_rate = _reader(RATE, 9), _writer(RATE, 9)
sum_of, put_sum = _reader(SUM, 9), _writer(SUM, 9)
#: (a, m, active) -> the model of lane m
model_of = written(
    "model_of",
    "a, m, active",
    [f"return Model(({', '.join(in_lane(12, 20))}), Drive({', '.join(in_lane(32, 15))}), active)"],
    {"Model": Model, "Drive": Drive},
)
