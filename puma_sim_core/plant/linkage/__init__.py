# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Parts of an arm: pendulums, slides, planar double pendulums, rotary pendulums, arms by their axes."""
