# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The experiments of the thesis, each a named thing that can be run.

``puma-sim thesis`` lists them; :mod:`puma_sim_core.thesis.registry` finds them,
:mod:`puma_sim_core.thesis.report` writes the page and the JSON.
"""
