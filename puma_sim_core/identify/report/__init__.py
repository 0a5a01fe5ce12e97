# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The report: JSON for programs, HTML for people."""
