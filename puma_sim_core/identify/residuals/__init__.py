# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stage 10: what no effect of the library explains, as free curves."""
