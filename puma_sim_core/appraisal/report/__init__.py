# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a battery found: report.json, scoreboard.csv, report.html, and bags of failed trials."""
