# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the HTML pages share: figures as SVG, numbers as text, templates with one style sheet."""
