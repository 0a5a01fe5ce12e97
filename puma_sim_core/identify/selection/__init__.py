# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stages 5 and 7: which effects are named, and errors on data that were not fitted."""
