# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 0: faults of the data, found before anything is explained."""
