# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The simulator of chapter 6 and what runs on it: sessions, batches, replay, open-loop windows."""
