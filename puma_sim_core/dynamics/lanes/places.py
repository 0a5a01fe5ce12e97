# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Where the numbers of a lane stand in the flat array of a group that follows a motion, and what reads and writes them.

Number k of lane m stands at k * LANES + m. The first are those of `registers`: state, voltages, body and drive; what
reads and writes these stands there.
"""

from puma_sim_core.dynamics.lanes.registers import LANE_NUMBERS, in_lane, lane_reader, lane_writer
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


levels_of, has_dry_of, near_limit_of, damping_of = (
    lane_reader(LEVELS, 6),
    lane_reader(HAS_DRY, 3),
    lane_reader(NEAR_LIMIT, 3),
    lane_reader(DAMPING, 3),
)
before_of, put_before = lane_reader(BEFORE, 9), lane_writer(BEFORE, 9)
step_drive_of, put_step_drive = lane_reader(STEP_DRIVE, 15), lane_writer(STEP_DRIVE, 15)
slip_of, put_slip = lane_reader(SLIP, 6), lane_writer(SLIP, 6)
trig_of, put_trig = lane_reader(TRIG, 4), lane_writer(TRIG, 4)
torque_of, put_torque = lane_reader(TORQUE, 3), lane_writer(TORQUE, 3)
stage_of, put_stage = lane_reader(STAGE, 9), lane_writer(STAGE, 9)
rate_of, put_rate = lane_reader(RATE, 9), lane_writer(RATE, 9)
sum_of, put_sum = lane_reader(SUM, 9), lane_writer(SUM, 9)
#: (a, m, active) -> the model of lane m
model_of = written(
    "model_of",
    "a, m, active",
    [f"return Model(({', '.join(in_lane(12, 20))}), Drive({', '.join(in_lane(32, 15))}), active)"],
    {"Model": Model, "Drive": Drive},
)
