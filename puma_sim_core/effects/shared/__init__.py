# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What several effects share: helpers of regressors, priors of dry friction, laws of drive trains."""
