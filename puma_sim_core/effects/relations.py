# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How effects are related: look-alikes, special cases, exact ties. Each pair stands once.

The registry gives each effect its part of these. An effect that is not listed here, such as a user's own, states its
relations in its own file.
"""

from __future__ import annotations

#: (one, other, what tells one from the other, what tells the other from the one); in the order of reports
LOOK_ALIKES: tuple[tuple[str, str, str, str], ...] = (
    (
        "coulomb_friction",
        "voltage_dead_band",
        "friction follows the sign of the velocity, the dead-band that of the voltage: the two differ where gravity drives the joint or brakes it",
        "the step follows the sign of the voltage, not of the velocity: the two differ where gravity drives the joint or brakes it",
    ),
    (
        "coulomb_friction",
        "stribeck_friction",
        "Coulomb friction is flat in the speed, without a bump at low speed",
        "friction rises as the joint slows down below a few times the Stribeck velocity",
    ),
    (
        "coulomb_friction",
        "asymmetric_coulomb_friction",
        "the step has the same height in both directions",
        "the step is of another height in each direction",
    ),
    (
        "asymmetric_coulomb_friction",
        "voltage_offset",
        "an offset also acts at rest and without a step at reversals; with Coulomb friction beside it, it is the same while the joint moves",
        "the constant does not need the joint to move",
    ),
    (
        "quadratic_friction",
        "voltage_saturation",
        "drag grows with the square of the speed at all voltages",
        "nothing is missing below the supply voltage, and all of the excess above it",
    ),
    (
        "load_dependent_friction",
        "position_dependent_friction",
        "the step follows the torque that the gear bears, which other joints and accelerations change too, not the joint's own position",
        "the step follows the joint's own position, not the load; a weight, accelerations, or other angles of the other joints, separate the two",
    ),
    (
        "coulomb_friction",
        "load_dependent_friction",
        "the step does not change with the load",
        "the step vanishes where the load does",
    ),
    (
        "coulomb_friction",
        "position_dependent_friction",
        "the step does not change with the position",
        "the height of the step changes with the position",
    ),
    (
        "coulomb_friction",
        "presliding_friction",
        "the step is sharp in position, without a hysteresis loop at the reversal",
        "friction turns over with the travel after a reversal, not at once",
    ),
    (
        "position_dependent_friction",
        "sensor_nonlinearity",
        "the torque is a step at reversals and does not grow with the speed",
        "the error grows with the speed, without a step at reversals",
    ),
    (
        "friction_warm_up",
        "resistance_drift",
        "the loss follows the speed, not the torque, and a hold against gravity does not change",
        "the growth follows the torque, also at rest against gravity, not the speed",
    ),
    (
        "supply_droop",
        "resistance_drift",
        "the loss follows the currents of all joints at once, from the beginning on",
        "the loss grows with time and follows the joint's own torque",
    ),
    (
        "voltage_saturation",
        "supply_droop",
        "the limit does not sag under the currents of other joints",
        "the loss is in proportion to the voltage, without a threshold",
    ),
    (
        "quadratic_friction",
        "supply_droop",
        "drag does not change with the currents of the joints",
        "a joint loses voltage also by the currents of the others",
    ),
    (
        "voltage_saturation",
        "current_limit",
        "the limit is one of the voltage, not of the current",
        "the limit is exceeded at one current, whatever the speed: at a fast reversal long before the greatest voltage",
    ),
    (
        "input_delay",
        "sensor_lag",
        "a delay shifts all frequencies by one time and all joints alike; a lag of the sensor is the joint's own and bends with the frequency",
        "the shift is the joint's own and its phase bends with the frequency; below a third of the cut-off a lag and a delay are the same",
    ),
    (
        "input_delay",
        "joint_elasticity",
        "the shift has no resonance and is common to all joints",
        "the link swings at a frequency of its own, on this joint",
    ),
    (
        "voltage_saturation",
        "input_delay",
        "the shortfall is that of the peaks, not of fast changes",
        "the shortfall is that of fast changes, not of the peaks",
    ),
    (
        "soft_stop",
        "joint_spring",
        "the torque begins with a kink at one position; seen only from inside, a stop is a spring",
        "the torque is straight over the whole range, without a kink",
    ),
    ("joint_elasticity", "sensor_lag", "the link swings at a frequency of its own", "the shift has no resonance"),
    (
        "backlash",
        "impulse",
        "the impacts come at each change of sign of the transmitted torque",
        "it comes once; two or more at reversals of the transmitted torque are backlash",
    ),
    (
        "joint_elasticity",
        "backlash",
        "the shaft twists in proportion to the torque, also without a change of its sign",
        "the link swings only where the transmitted torque changes its sign",
    ),
    (
        "presliding_friction",
        "backlash",
        "the loop comes at reversals of the velocity, not of the transmitted torque",
        "the impacts come where the transmitted torque changes its sign, not the velocity",
    ),
    (
        "coulomb_friction",
        "backlash",
        "the friction lasts as long as the joint moves",
        "nothing is lost between the impacts",
    ),
    (
        "presliding_friction",
        "joint_elasticity",
        "the loop depends on the travel, not on the frequency",
        "the twist follows the transmitted torque, not the travel after a reversal",
    ),
    (
        "transmission_error",
        "torque_ripple",
        "the torque grows with load, speed and acceleration",
        "the waves are tied to the motor's turns, and their torque does not grow with speed or load",
    ),
    (
        "transmission_error",
        "sensor_nonlinearity",
        "the motor's back-EMF has no part in it: the error is in the link's position, not in the measured one",
        "the error goes with back-EMF, so with the speed, more than with load and inertia",
    ),
    ("torque_ripple", "sensor_nonlinearity", "the waves do not grow with the speed", "the waves vanish at rest"),
    (
        "position_dependent_friction",
        "torque_ripple",
        "the torque changes sign with the velocity, and its period is that of the joint, not of the motor",
        "the waves do not change sign with the velocity",
    ),
    (
        "joint_spring",
        "base_tilt",
        "the torque is a line in the joint's own position, on this joint alone",
        "joint 1 feels gravity with a period of a turn, and more with the arm stretched out",
    ),
    (
        "payload",
        "joint_spring",
        "the torques of all joints keep the ratios of one mass at one place",
        "the torque is a line in the joint's own position, on this joint alone",
    ),
    (
        "load_dependent_friction",
        "payload",
        "the torque changes sign with the velocity, a weight's does not",
        "a weight pulls the same way in both directions of motion",
    ),
    (
        "voltage_offset",
        "joint_spring",
        "the constant does not change with the position",
        "the torque changes with the position; a spring with an offset is a spring that is slack at another angle",
    ),
    ("voltage_offset", "base_tilt", "the constant does not turn with the pose", "the torque turns with joint 1"),
    (
        "asymmetric_coulomb_friction",
        "base_tilt",
        "the difference of the levels does not turn with the pose",
        "the torque does not change with the direction of motion",
    ),
    (
        "payload",
        "encoder_offset",
        "inertia grows with the weight",
        "the torque is the slope of gravity's: in quadrature with a weight's",
    ),
    (
        "base_tilt",
        "encoder_offset",
        "joint 1 feels gravity too",
        "the error turns with the joint, and joint 1 feels no gravity",
    ),
    (
        "joint_spring",
        "encoder_offset",
        "the torque is a line in the position, also where gravity's slope changes",
        "the torque follows the slope of gravity's torque, not the position",
    ),
    (
        "asymmetric_coulomb_friction",
        "joint_spring",
        "the difference of the levels does not change with the position",
        "the torque changes with the position, not with the direction of motion",
    ),
    (
        "presliding_friction",
        "joint_spring",
        "the restoring torque ends within a milliradian of each reversal",
        "the torque grows over the whole range, not within a milliradian of each reversal",
    ),
    (
        "stribeck_friction",
        "presliding_friction",
        "the bump is one in velocity, not a loop in position after the reversal",
        "the torque follows the travel since the reversal, not the speed",
    ),
    (
        "asymmetric_coulomb_friction",
        "stribeck_friction",
        "the levels differ by direction and do not change with the speed",
        "the bump is the same in both directions",
    ),
    (
        "stribeck_friction",
        "backlash",
        "the bump comes at reversals of the velocity, not of the transmitted torque",
        "the impacts come at changes of sign of the transmitted torque, not at low speed",
    ),
    (
        "stribeck_friction",
        "quadratic_friction",
        "friction changes at low speed, not at high speed",
        "the curve bends at high speed, not at low speed",
    ),
    (
        "stribeck_friction",
        "impulse",
        "the bump comes back at each slow motion",
        "it comes once, not at each slow motion",
    ),
    (
        "quadratic_friction",
        "friction_warm_up",
        "the drag is the same at the beginning and at the end",
        "friction falls with time at the same speed",
    ),
    (
        "quadratic_friction",
        "current_limit",
        "the drag comes with the speed, not with great torque",
        "the shortfall comes at great torque, not at great speed",
    ),
    (
        "current_limit",
        "supply_droop",
        "the joint's own current explains it, not that of the others",
        "the currents of the other joints explain it too, without a threshold",
    ),
    (
        "voltage_offset",
        "encoder_offset",
        "the constant does not follow the slope of gravity's torque",
        "the torque follows the slope of gravity's torque",
    ),
    (
        "voltage_offset",
        "payload",
        "the constant stays on its joint and is the same in all poses",
        "the torque changes with the pose",
    ),
    (
        "voltage_dead_band",
        "voltage_offset",
        "the loss changes sign with the voltage",
        "the constant does not change sign with the voltage",
    ),
    (
        "asymmetric_coulomb_friction",
        "voltage_dead_band",
        "the step follows the sign of the velocity and differs by direction",
        "the step has one height, by the sign of the voltage",
    ),
    (
        "payload",
        "resistance_drift",
        "the torque is the same at the beginning and at the end",
        "the torque seems to grow with time",
    ),
    (
        "soft_stop",
        "payload",
        "the torque stays on its joint and is zero before the kink",
        "all joints feel the weight, in all poses",
    ),
    (
        "presliding_friction",
        "soft_stop",
        "the loop comes after each reversal, at any position",
        "the torque comes back at the same position, not after each reversal",
    ),
    (
        "soft_stop",
        "impulse",
        "the torque comes back whenever the joint comes back to the same position",
        "it comes at one time, not at one position",
    ),
    (
        "sensor_lag",
        "sensor_nonlinearity",
        "the error follows the speed, not the place",
        "the error follows the place, not the speed alone",
    ),
)

#: effect -> special cases that it includes; where they are enough they are named
CONTAINS: dict[str, tuple[str, ...]] = {
    "asymmetric_coulomb_friction": ("coulomb_friction",),
    "stribeck_friction": ("coulomb_friction",),
    "presliding_friction": ("coulomb_friction",),
    "position_dependent_friction": ("coulomb_friction",),
    "impulse": ("current_limit", "voltage_saturation", "soft_stop"),
    "soft_stop": ("joint_spring",),
}

#: (one, other, why): what voltage and position alone can never tell apart
EXACT_TIES: tuple[tuple[str, str, str], ...] = (
    (
        "the constant of back-EMF",
        "viscous_friction",
        "both take a voltage in proportion to the speed; only heat and cold, or a current, differ",
    ),
    (
        "the ratio of resistance to torque constant",
        "the scale of all torques of the joint",
        "voltage is their product; a known weight or a measured current separates them",
    ),
    ("input_delay", "a delay of the sensor", "the log shows the sum of the two delays"),
    (
        "the gain of the amplifier",
        "resistance, back-EMF and inductance together",
        "all voltages scale by it; a voltmeter at the motor separates them",
    ),
    ("voltage_offset", "a constant torque", "both are a constant in the voltage"),
    (
        "asymmetric_coulomb_friction",
        "coulomb_friction with voltage_offset",
        "while the joint moves they are the same; at rest friction holds and an offset pushes",
    ),
    ("joint_spring", "a spring slack at another angle with voltage_offset", "both are a line in the position"),
    (
        "payload",
        "a direction of the inertial parameters of the last link",
        "the arm without the load is known only within the widths of its parameters",
    ),
)
