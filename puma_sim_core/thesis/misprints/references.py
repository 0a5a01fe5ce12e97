# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Misprints in captions, numbers of equations and references: `contents.yaml` says what each place holds."""

from pathlib import Path

from puma_sim_core.files import read_yaml
from puma_sim_core.thesis.misprints.evidence import read_errata

CONTENTS = read_yaml(Path(__file__).with_name("contents.yaml"))


def prove_reference(subject: str, printed: str, correct: str) -> tuple[object, object, object]:
    """What the reader finds at the two places."""
    return subject, CONTENTS["places"][correct], CONTENTS["places"].get(printed, "no such place")


def prove_number_used_twice(number: str) -> tuple[object, object, object]:
    """A number names one equation."""
    return 1, 1, len(CONTENTS["equations_of_one_number"][number])


def prove_caption(plot: str, text: str, caption: str) -> tuple[object, object, object]:
    """What two lists of the contents say of a plot."""
    return CONTENTS[text][plot], CONTENTS[text][plot], CONTENTS[caption][plot]


ROWS = read_errata("errata_references.yaml", globals())
