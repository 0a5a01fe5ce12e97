# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The step: circuit, torques, rigid body, stick and slip, two-mass joints, and whole runs of them."""
