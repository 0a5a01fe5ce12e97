# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The parts of `sim_node`."""
