# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""``python -m puma_sim_core``: the command `puma-sim`."""

import sys

from puma_sim_core.cli import main

sys.exit(main())
