# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One trial: the plant that a controller meets, what is left behind, and controllers that misbehave."""
