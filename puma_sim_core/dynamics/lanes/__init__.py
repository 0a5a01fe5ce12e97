# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Several runs side by side: in the lanes of vector registers, or in arrays of NumPy."""
