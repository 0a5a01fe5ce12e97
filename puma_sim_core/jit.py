# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Compiling the kernel: by numba where it is installed, plain Python otherwise.

The environment variable ``PUMA_SIM_KERNEL`` chooses: ``numba`` (an error where it is missing), ``python``, or ``auto``,
the default. Both give the same bits: numba's fast-math options stay off, so that no product is fused with a sum, and
both call the same sine, cosine and exponential of the C library. So a process may begin with plain Python while another
one compiles (`compiling`), and change over between two runs.
"""

import hashlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from types import CellType, CodeType, FunctionType
from typing import Any, TypeVar, cast

from puma_sim_core.errors import ParameterError

_PACKAGE = Path(__file__).resolve().parent
#: folders and files that compiled functions stand in; a change of any of them makes an older cache void
_SOURCES = ("jit.py", "dynamics", "servo", "effects", "control/sample_laws.py", "identify/screening/known_effects.py")


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


def _compiler() -> str:
    """Release of numba and processor that it compiles for: its own cache serves no other."""
    if BACKEND != "numba":
        return ""
    import numba
    from numba.core.codegen import get_host_cpu_features

    return f"numba {numba.__version__} {get_host_cpu_features()}"


def _source_digest() -> str:
    """Digest of all sources that are compiled together, and of where they stand.

    numba's own cache looks only at the file of the function itself, and would go on using an
    entry whose callee in another file has changed. It keeps the code of two copies of a file apart,
    so what one copy of the package has compiled is not there for another.
    """
    digest = hashlib.sha256(f"{sys.version}{_compiler()}{_PACKAGE}".encode())
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


#: parts of the kernel, in the order in which they are compiled ahead: an arm whose links follow its motors, one with
#: drive trains, and what `explain` runs beside them
PARTS = ("arm", "trains", "identification")
#: those of `appraise`: the last has single samples, for controllers that are Python objects
APPRAISAL_PARTS = ("arm", "trains", "trials")
#: those that run as plain Python for now -> whether they still have to
_AWAITED: dict[str, Callable[[], bool]] = {}
_HERE = threading.local()


def compiled_mark(part: str) -> Path | None:
    """The file that says that a part is in the cache; None without a cache."""
    return None if _CACHE is None else Path(_CACHE) / f"compiled-{part}"


def compiled_ahead(part: str) -> bool:
    """Whether a part is in the cache, so that a first call of it compiles nothing."""
    mark = compiled_mark(part)
    return mark is not None and mark.exists()


def await_compiled(part: str, awaited: Callable[[], bool]) -> None:
    """Run a part as plain Python as long as `awaited()` is true."""
    _AWAITED[part] = awaited


def is_compiled(part: str) -> bool:
    """Whether runs that begin now take the compiled form of a part."""
    if BACKEND != "numba" or hasattr(_HERE, "compiled"):
        return BACKEND == "numba"
    awaited = _AWAITED.get(part)
    if awaited is not None and not awaited():
        # another thread may have seen the same
        _AWAITED.pop(part, None)
    return part not in _AWAITED


def kernel_in_use() -> str:
    """Name of the kernel that runs of an arm that begin now take."""
    return BACKEND if is_compiled("arm") else "python"


@contextmanager
def compiled_here() -> Iterator[None]:
    """Take the compiled form in this thread, awaited or not: for one that loads it."""
    _HERE.compiled = True
    try:
        yield
    finally:
        del _HERE.compiled


def interpreted(function: F) -> F:
    """The plain Python of a function that is inlined elsewhere, for a caller that is not compiled
    (a call would compile it, for a second)."""
    return cast(F, getattr(function, "py_func", function))


_PLAIN: dict[Any, Any] = {}


def plain(function: F) -> F:
    """The plain Python of a function and of all that it calls, whatever is compiled of it."""
    source = getattr(function, "py_func", None)
    if source is None:
        return function
    if function not in _PLAIN:
        scope = source.__globals__
        names = {name: plain(scope[name]) for name in _names(source.__code__) if name in scope}
        cells = tuple(CellType(plain(cell.cell_contents)) for cell in source.__closure__ or ())
        names["__builtins__"] = scope["__builtins__"]
        _PLAIN[function] = FunctionType(source.__code__, names, source.__name__, source.__defaults__, cells)
    return cast(F, _PLAIN[function])


def _names(code: CodeType) -> set[str]:
    """Global names that a code uses, those of functions inside it included."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def fitting(function: F, table: Table) -> F:
    """The form of a function that takes a table as it is: compiled for an array, plain Python for a list."""
    return plain(function) if type(table) is list else function


def written(
    name: str, arguments: str, body: list[str], functions: dict[str, Any], jit: Callable[..., Any] = inlined
) -> Callable[..., Any]:
    """The inlined function of a body written as lines of source."""
    source = f"def {name}({arguments}):\n" + "".join(f"    {line}\n" for line in body)
    scope: dict[str, Any] = {**functions, "inf": inf}
    exec(compile(source, f"<written: {name}>", "exec"), scope)
    function: Callable[..., Any] = jit(scope[name])
    return function
