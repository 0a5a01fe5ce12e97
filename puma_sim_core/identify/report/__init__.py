# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The report: JSON for programs, HTML for people."""
