# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stage 11: the next experiment that separates what a log cannot tell apart."""
