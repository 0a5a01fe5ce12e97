# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Records of runs: CSV files and bags."""
