# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The step: circuit, torques, rigid body, stick and slip, two-mass joints, and whole runs of them."""
