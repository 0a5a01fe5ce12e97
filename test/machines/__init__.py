# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Simulated logs of the machines of `config/mechanisms`, with effects that are known.

`records` draws a machine, its true parameters, a motion and effects, and runs them; `judging` compares an answer with
what was there; `run` is the command. The logs come from the package's own simulator, so that they say nothing of its
equations: they are for what an identification makes of machines of other sizes than the PUMA 560.
"""
