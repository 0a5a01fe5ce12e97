# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Margins of the sampled loop: by linearisation of a controller object, or by injection into any closed loop."""
