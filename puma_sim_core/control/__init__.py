# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Controllers, and the setpoints that they follow."""
