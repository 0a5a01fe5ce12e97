# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 3: the noise of residuals and innovations, and whitening filters."""
