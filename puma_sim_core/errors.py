# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Errors that users meet: each names what is wrong, where it stands and what was expected."""

import difflib
from collections.abc import Iterable


class PumaSimError(ValueError):
    """Base of all errors of the package; its text is ``WHERE: WHAT; expected EXPECTED``.

    Parameters
    ----------
    what : what is wrong, with the offending value.
    where : the file, row, key, topic or step at which it stands.
    expected : what would have been right.
    """

    def __init__(self, what: str, *, where: object = None, expected: str | None = None):
        self.what, self.where, self.expected = what, where, expected
        text = what if where is None else f"{where}: {what}"
        super().__init__(text if expected is None else f"{text}; expected {expected}")


class ParameterError(PumaSimError):
    """A parameter of the arm, an effect, a session or an option is not usable."""


class ModelError(PumaSimError):
    """A model file or record cannot be rebuilt by this version."""


class RecordingError(PumaSimError):
    """A table of voltages or of measurements is not usable."""


class CommandError(PumaSimError):
    """A command was refused; the last good one stays in force."""


class LimitError(PumaSimError):
    """A joint left its range or exceeded its greatest velocity or acceleration."""


class TuningError(PumaSimError):
    """A joint has no ultimate gain, so that there is nothing to take settings from."""


class BagError(PumaSimError):
    """A bag cannot be written, read, recovered or replayed."""


class NonFiniteStateError(PumaSimError):
    """The state stopped being finite. ``step`` is the step that made it so."""

    def __init__(self, step: int, what: str = "the state is no longer finite"):
        self.step = step
        super().__init__(what, where=f"step {step}", expected="finite positions, velocities, currents")


#: as many names as an error lists where they stand elsewhere, too
LISTED = 8


def _equally_near(name: str, near: list[str]) -> bool:
    """Whether two names are equally near to another."""
    ratios = [difflib.SequenceMatcher(None, each, name).ratio() for each in near]
    return len(set(ratios)) < len(ratios)


def one_of(name: object, known: Iterable[object], listed: str | None = None) -> str:
    """What was expected in place of a name: the names there are, the nearest first if one is; of many the nearest alone
    where something else, `listed`, has all of them.
    """
    names = list(map(str, known))
    # the beginning of a name is near, however much is missing
    begun = [each for each in names if name and each.startswith(str(name))]
    near = begun[:2] or difflib.get_close_matches(str(name), names, n=2)
    if listed is None or len(names) <= LISTED:
        first = [] if _equally_near(str(name), near) else near[:1]
        return f"one of {', '.join([*first, *(each for each in names if each not in first)])}"
    if not near:
        return f"one of those of {listed}"
    return f"{' or '.join(near)}, which {'is' if len(near) == 1 else 'are'} near, or another of {listed}"
