# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 12: the reading of a sensor on the link's side, compared with that of the motor."""
