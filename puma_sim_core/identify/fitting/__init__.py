# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 6: hypotheses put into the model and fitted to the innovations of its Kalman predictor."""
