# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A motion that the drives did not make, such as that of an arm that bears its weight while a hand moves it.

The torques of the drives then follow from the position alone, by the law of the controller, and a machine that is left
to itself under such torques swings, or falls into a stop: its accelerations follow from position and velocity. Where
they do not, something moves it that the log does not have. Fits to such a log give the controller, not the machine
(Soederstroem, Gustavsson and Ljung 1975, Int. J. Control 21:243).
"""

import numpy as np

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.checks.plausibility import Plausibility, ends, rms, too_uneven
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample, shortest_span
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS


def undriven(part: Log, model: Plausibility) -> list[Fault]:
    """Faults of the inputs of a machine that something else moves: of all joints that are driven, or none."""
    short = part.span < shortest_span(float(np.median(np.diff(part.time))))
    if short or too_uneven(part) or not np.ptp(part.voltage, axis=0).any():
        return []
    mechanism, drive, theta, s = model.mechanism, model.drive, model.theta, sample([part])
    kept, q, qd, qdd = s.kept(), s.position, s.velocity, s.acceleration
    still = np.zeros_like(q)
    torque = mechanism.total_torque(theta, q, qd, qdd) - mechanism.total_torque(theta, q, qd, still)
    # the weight of the links, and that of links with other parameters
    weights = np.dstack(
        [mechanism.total_torque(theta, q, still, still), mechanism.torque_jacobian(theta, q, still, still)]
    )
    # what the back-EMF takes of the voltage follows from the velocity, as friction does
    given, inertial = s.second(s.voltage / drive.volts_per_torque)[kept], s.second(torque)[kept]
    fastest = np.maximum(np.abs(qd).max(axis=0), 1e-12)
    dry = np.tanh(qd / (CHECKS.plausibility_dry_width * fastest))
    moved = False
    for j, scale in enumerate(mechanism.torque_scale):
        own_weights = weights[:, j][:, weights[:, j].any(axis=0)]
        at_rest = np.column_stack([np.ones(len(kept)), s.second(np.column_stack([q, own_weights]))[kept]])
        moving = s.second(np.column_stack([qd[:, j], dry[:, j], *ends(q[:, j])]))[kept]
        own = rms(_beyond(at_rest, given[:, j]))
        needed = _beyond(np.column_stack([at_rest, moving]), inertial[:, j])
        if own > CHECKS.undriven_own * np.std(given[:, j]) or own > CHECKS.undriven_share * rms(needed):
            return []
        alone = rms(needed) > CHECKS.undriven_left * np.std(inertial[:, j])
        moved |= bool(alone and np.abs(needed).max() > scale)
    return [
        Fault.of(
            f"voltage{j + 1}",
            None,
            "it follows from the position alone, and something that is not in the log moves the machine",
            "a motion that the drives make",
        )
        for j, driven in enumerate(mechanism.driven)
        if moved and driven
    ]


def _beyond(columns: Floats, values: Floats) -> Floats:
    """What (n,) values have beyond (n, p) columns, by least squares."""
    return values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
