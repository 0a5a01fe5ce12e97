# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stage 1: logs read, put on one even grid, and filtered."""
