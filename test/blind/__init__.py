# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Blind records: measured-looking logs of an arm that shares no code with the project.

The rigid arm, dry friction, springs, stops, play and elastic drives are MuJoCo's, at steps of
0.1 ms; motors, amplifiers, sensors and the controller are a script of this folder. Nothing here
imports `puma_sim_core`, and nothing there may read `answers.json`: only assertions do.

Seeds are kept apart, so that no figure comes from records that thresholds were set on:
1000-1099 the records committed under `records/`, 2000-2999 development, 920000 and above the
final score. A seed is one of a version of the generator (`records.VERSION`): version 1 made the
committed records and all scores up to seed 920339, version 2 draws anew, with the cases of `cases`.
"""
