# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""An arm with its effects, and mechanisms with priors of their parameters."""
