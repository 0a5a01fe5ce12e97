# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Compiling the kernel: by numba where it is installed, plain Python otherwise.

A process uses one of the two throughout. The environment variable ``PUMA_SIM_KERNEL`` chooses:
``numba`` (an error where it is missing), ``python``, or ``auto``, the default. Both give the same
bits: numba's fast-math options stay off, so that no product is fused with a sum, and both call
the same sine, cosine and exponential of the C library.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Any, TypeVar, cast

from puma_sim_core.errors import ParameterError

_PACKAGE = Path(__file__).resolve().parent
#: folders and files that compiled functions stand in; a change of any of them makes an older cache void
_SOURCES = ("jit.py", "dynamics", "servo", "effects", "simulation/tracking.py", "identify/screening/known_effects.py")


def _choose() -> str:
    wanted = os.environ.get("PUMA_SIM_KERNEL", "auto")
    if wanted not in ("auto", "numba", "python"):
        raise ParameterError(
            f"kernel '{wanted}'", where="environment variable PUMA_SIM_KERNEL", expected="auto, numba or python"
        )
    if wanted == "python":
        return "python"
    try:
        import numba  # noqa: F401
    except ImportError:
        if wanted == "numba":
            raise ParameterError(
                "numba is not installed",
                where="environment variable PUMA_SIM_KERNEL",
                expected="python or auto, or `pip install numba`",
            ) from None
        return "python"
    return "numba"


_FURTHER: list[Path] = []


def add_source(path: Path) -> None:
    """Count a file among what compiled functions are made of, such as that of a user's own effect."""
    global _CACHE
    if path not in _FURTHER:
        _FURTHER.append(path)
        # what is decorated from here on may be made of it
        _CACHE = cache_directory() if BACKEND == "numba" else None


def _source_digest() -> str:
    """Digest of all sources that are compiled together.

    numba's own cache looks only at the file of the function itself, and would go on using an
    entry whose callee in another file has changed.
    """
    digest = hashlib.sha256(sys.version.encode())
    for name in _SOURCES:
        path = _PACKAGE / name
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            if file.exists():
                digest.update(file.name.encode() + file.read_bytes())
    for file in _FURTHER:
        digest.update(str(file).encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def cache_directory() -> str | None:
    """A writable folder for compiled code, or None: an install without one compiles each time."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    try:
        # a user without an entry in the password file has no ~
        folder = Path(base).expanduser() / "puma_sim" / f"kernel-{_source_digest()}"
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except (OSError, RuntimeError):
        return None
    return str(folder)


#: several numbers, and a flat array of them (n,): an array of float64 where it is compiled, a list in plain Python
Vec = tuple[float, ...]
Table = Any

BACKEND = _choose()
_CACHE = cache_directory() if BACKEND == "numba" else None

#: a function, with the type that it has
F = TypeVar("F", bound=Callable[..., Any])

if BACKEND == "numba":
    import numba

    def _njit(function: F, **options: Any) -> F:
        return cast(F, numba.njit(function, nogil=True, error_model="numpy", **options))

    def inlined(function: F) -> F:
        """Compile as a part of its callers."""
        return _njit(function, forceinline=True)

    def outlined(function: F) -> F:
        """Compile as a function of its own that compiled callers call."""
        return _njit(function)

    def merged(function: F) -> F:
        """Put the source into its callers: for a large function that calls much, since each level
        of calls has all code below it optimised once more."""
        return _njit(function, inline="always")

    def compiled(function: F) -> F:
        """Compile as an entry that Python calls, kept on disk."""
        before = numba.config.CACHE_DIR
        try:
            # numba looks the folder up while it decorates; other users of numba keep theirs
            numba.config.CACHE_DIR = _CACHE or before
            return _njit(function, cache=_CACHE is not None)
        finally:
            numba.config.CACHE_DIR = before

else:

    def _as_it_is(function: F) -> F:
        """The function as it is."""
        return function

    inlined = outlined = merged = compiled = _as_it_is


def compiles_first() -> bool:
    """Whether the first run will compile the kernel, for some ten seconds, instead of loading it."""
    if BACKEND != "numba":
        return False
    return _CACHE is None or next(Path(_CACHE).rglob("*.nbi"), None) is None


def interpreted(function: F) -> F:
    """The plain Python of a function that is inlined elsewhere, for a caller that is not compiled
    (a call would compile it, for a second)."""
    return cast(F, getattr(function, "py_func", function))


def written(
    name: str, arguments: str, body: list[str], functions: dict[str, Any], jit: Callable[..., Any] = inlined
) -> Callable[..., Any]:
    """The inlined function of a body written as lines of source."""
    source = f"def {name}({arguments}):\n" + "".join(f"    {line}\n" for line in body)
    scope: dict[str, Any] = {**functions, "inf": inf}
    exec(compile(source, f"<written: {name}>", "exec"), scope)
    function: Callable[..., Any] = jit(scope[name])
    return function
