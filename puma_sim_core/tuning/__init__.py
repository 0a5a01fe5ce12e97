# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Controllers tuned and identified: Ziegler-Nichols, gain schedules, PID gains from records."""
