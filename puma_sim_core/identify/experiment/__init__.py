# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 11: the next experiment that separates what a log cannot tell apart."""
