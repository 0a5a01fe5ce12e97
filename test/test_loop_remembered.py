# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Results that are kept."""

import numpy as np
import pytest

from puma_sim_core.identify.remembered import Remembered


def ask(remembered, *keys):
    """The keys that had to be made."""
    made = []
    for key in keys:
        array = remembered(key, lambda key=key: made.append(key) or np.full(3, float(key)))
        np.testing.assert_array_equal(array, np.full(3, float(key)))
    return made


def test_what_is_kept_is_not_made_again():
    assert ask(Remembered(2), 1, 1, 2, 1, 2, 2) == [1, 2]


def test_what_was_asked_for_longest_ago_goes_first():
    assert ask(Remembered(2), 1, 2, 1, 3, 1, 2) == [1, 2, 3, 2]


def test_an_array_that_others_will_get_cannot_be_written_to():
    kept = Remembered(1)(0, lambda: np.zeros(2))
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 1.0


def test_an_error_is_not_kept():
    remembered = Remembered(1)

    def fail():
        raise KeyError("no")

    with pytest.raises(KeyError):
        remembered(0, fail)
    assert ask(remembered, 0) == [0]
