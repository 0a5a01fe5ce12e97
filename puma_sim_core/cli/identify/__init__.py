# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Commands that learn from logs: of what the model lacks, of a machine, of the next experiment, of a controller."""
