# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The digital servo of the joints, as compiled code and as objects."""
