# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Long runs of the node: how many times something holds, not whether it holds once."""
