# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bench of real machines: `make rigs`, on measured logs that are not part of this project.

`rigs.yaml` says which machines, logs and answers there are, and `catalogue` reads it. `variants` are changes that must
not change an answer, `jobs` explains in a process of its own, `measures` are the errors that others publish, `judging`
compares with the expected answer, `table` writes the page, `run` is the program.
"""
