# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Records of runs: CSV files and bags."""
