# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What several effects share: helpers of regressors, priors of dry friction, laws of drive trains."""
