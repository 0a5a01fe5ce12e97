# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Tasks: what the arm is to do, what is done to it, and the limits that pass or fail is judged by."""
