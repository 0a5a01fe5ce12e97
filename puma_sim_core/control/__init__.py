# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Controllers, and the setpoints that they follow."""
