# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 1: logs read, put on one even grid, and filtered."""
