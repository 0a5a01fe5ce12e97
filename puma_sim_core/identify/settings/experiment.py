# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 11: the next experiment (`identify.experiment`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Experiment:
    """Thresholds of this stage."""

    design_motions: int = 150  #: motions of a search
    design_fewer_motions: int = 80  #: and of one whose columns take long
    #: part of them without the compiled kernel, ten times slower
    design_uncompiled: float = 0.2
    design_many_columns: int = 40  #: columns from which they take long
    design_random: float = 0.4  #: share of the motions that are random
    design_kept: int = 4  #: best ones that are gone on from
    design_suspects: int = (
        4  #: effects that one motion is to tell apart: each pair both ways takes 12 simulations a motion
    )
    #: motions that a look for exact ties takes; gain [nat] and share that are nothing in all of them
    design_looks: int = 10
    design_nothing: float = 0.5
    design_no_share: float = 1e-4
    design_wrong: float = 0.08  #: how wrong parameters may be
    design_viscous_wrong: float = 0.25  #: and viscous friction
    design_machines: int = 4  #: machines that are tried
    design_smaller: float = 0.85  #: factor by which a motion is made smaller where a machine leaves its ranges
    design_coarse_step: float = 5e-3  #: step [s] where machines need only stay in their ranges
    #: rows of a file, and the least rate that the filters of `explain` can use [1/s]
    design_most_rows: int = 300_000
    design_least_rate: float = 100.0
    design_shortest: float = 2.0
    design_longest: float = 600.0

    motion_harmonics: int = 5
    motion_fast: int = 3
    motion_rest: float = 0.15  #: rest at the start and at the end of a record [s]
    motion_swell: float = 0.8  #: time in which a motion swells [s]
    motion_base: float = 0.4  #: greatest frequency of the Fourier series' base [Hz]
    motion_fast_band: tuple[float, float] = (4.0, 15.0)  #: frequencies of the fast waves [Hz]
    motion_sharp: float = 0.97  #: how sharp the corners of a triangle are: 1 is a corner
    motion_margin: float = 0.06  #: share of the range that is kept free at each end
    motion_voltage_share: float = 0.95  #: share of the voltage that is used
    motion_arm_voltage: float = 40.0  #: supply of the arm's motors [V]
    motion_other_voltage: float = 10.0  #: of others, in voltages of the nominal friction torque
    motion_speed: float = 0.6  #: greatest speed where none is given, in ranges of the joint a second

    offer_looks: int = 6  #: motions without a sign of an effect before none is said to show it
    offer_seconds: float = 5.0  #: their length [s]

    separation_noise: float = 0.05  #: noise of the voltage [V] within the second filter's band
    separation_step: float = 5e-3  #: step of columns [s]
    separation_fine: float = 2.5e-3  #: of waves of the motor's angle, which would alias, and of shifts [s]
    separation_coarse: float = 1e-2  #: of parameters' derivatives, which are smooth [s]
    separation_kept: float = 2e-2  #: of the rows that are kept [s]
    separation_counts: float = 1000.0  #: of an encoder a turn of the motor
    separation_counts_of_range: float = 16384.0  #: of one joint without gears, over its range
    separation_block: int = 64  #: rows of a block of a product


EXPERIMENT = Experiment()
