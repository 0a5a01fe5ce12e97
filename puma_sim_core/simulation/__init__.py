# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The simulator of chapter 6 and what runs on it: sessions, batches, replay, open-loop windows."""
