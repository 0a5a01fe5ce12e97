# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stages 2 and 4: residual, regressors of all effects, marginal likelihoods, short list."""
