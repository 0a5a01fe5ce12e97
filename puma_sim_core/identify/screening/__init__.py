# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stages 2 and 4: residual, regressors of all effects, marginal likelihoods, short list."""
