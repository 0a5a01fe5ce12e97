# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stage 0: faults of the data, found before anything is explained."""
