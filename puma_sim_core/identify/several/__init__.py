# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Several logs: each explained alone, and their answers compared."""
