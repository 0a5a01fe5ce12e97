# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An arm with its effects, and mechanisms with priors of their parameters."""
