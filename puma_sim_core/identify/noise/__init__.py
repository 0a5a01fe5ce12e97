# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stage 3: the noise of residuals and innovations, and whitening filters."""
