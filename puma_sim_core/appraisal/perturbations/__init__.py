# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What differs from the nominal arm in a trial: draws, and effects of the library at a size."""
