# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How fast the simulator is beside others: ``python -m benchmarks``, or ``make bench``.

All rows do one task (`task`): 10 s of the three-joint arm with its motors. They are measured in
one run, in turn, round after round, and compared within each round, so that whatever else the
machine does meets them alike. Each row says how far its arm ends from ours: a peer that
simulates another arm would not be a peer.
"""
