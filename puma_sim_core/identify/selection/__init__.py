# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stages 5 and 7: which effects are named, and errors on data that were not fitted."""
