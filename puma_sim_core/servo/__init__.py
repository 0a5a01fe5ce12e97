# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The digital servo of the joints, as compiled code and as objects."""
