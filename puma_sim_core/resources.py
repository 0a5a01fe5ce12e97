# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Where the files of ``config/`` are, in a checkout and in an installed package."""

from pathlib import Path

_HERE = Path(__file__).resolve().parent
#: an installed package carries ``config/`` inside itself; a checkout has it beside the package
_CANDIDATES = (_HERE / "config", _HERE.parent / "config")


def config_path(*parts: str) -> Path:
    """Path of a file or folder of ``config/``.

    Raises FileNotFoundError: when neither place has it.
    """
    for root in _CANDIDATES:
        path = root.joinpath(*parts)
        if path.exists():
            return path
    raise FileNotFoundError(f"config/{'/'.join(parts)} is in none of {[str(c) for c in _CANDIDATES]}")
