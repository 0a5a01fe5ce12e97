# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The PUMA 560's first three joints with their motors, simulated; no ROS in this package."""

__version__ = "0.1.0"
