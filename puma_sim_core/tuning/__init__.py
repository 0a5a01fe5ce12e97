# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Controllers tuned and identified: Ziegler-Nichols, gain schedules, PID gains from records."""
