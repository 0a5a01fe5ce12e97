# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The battery of `puma_sim_core.appraisal` for controllers that are processes over topics.

The protocol is described in docs/appraisal_topics.md.
"""
