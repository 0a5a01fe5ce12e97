# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Control appraisal: measures of a trial, statistics over trials, margins of the sampled loop."""
