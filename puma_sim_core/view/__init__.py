# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A motion in the browser: the arm, its path, its plots; and the same as one file that needs no network."""
