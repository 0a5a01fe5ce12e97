# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 10: what no effect of the library explains, as free curves."""
