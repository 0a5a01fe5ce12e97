# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How effects are related, from relations.yaml: look-alikes, special cases, exact ties. Each pair stands once.

An effect that is not listed there, such as a user's own, states its relations in its own file.
"""

from pathlib import Path

from puma_sim_core.files import read_yaml

_FILE = read_yaml(Path(__file__).with_suffix(".yaml"))
#: (one, other, what tells one from the other, what tells the other from the one); in the order of reports
LOOK_ALIKES: tuple[tuple[str, str, str, str], ...] = tuple(map(tuple, _FILE["look_alikes"]))
#: effect -> special cases that it includes; where they are enough they are named
CONTAINS: dict[str, tuple[str, ...]] = {name: tuple(cases) for name, cases in _FILE["contains"].items()}
#: effect -> those of them that it only looks like while the joint stays on one side of where it acts
ALIKE_IN_PART: dict[str, tuple[str, ...]] = {name: tuple(cases) for name, cases in _FILE["alike_in_part"].items()}
#: (one, other, why): what voltage and position alone can never tell apart
EXACT_TIES: tuple[tuple[str, str, str], ...] = tuple(map(tuple, _FILE["exact_ties"]))
