# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Memory that is free goes back to the system between the stages of an explanation."""

import ctypes
import sys
from collections.abc import Callable


def _trim() -> Callable[[int], int] | None:
    """`malloc_trim` of the GNU C library, None elsewhere."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        found: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):
        return None
    return found


_TRIM = _trim()


def release() -> None:
    """Give freed memory back where the C library can.

    The GNU C library keeps freed arrays of up to 32 MB in a heap for each thread: what fits that are made and thrown
    away leave there is half of the memory that a process seems to need.
    """
    if _TRIM is not None:
        _TRIM(0)
