# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The PUMA 560's first three joints with their motors, simulated; no ROS in this package.

The names of `__all__` are the public interface; `__init__.pyi` lists them. Each is imported when it is first used, so
that importing the package costs neither NumPy nor a compiler::

    import puma_sim_core as ps

    plant = ps.Plant.of("bejczy", [ps.parse_effect("coulomb_friction:joint=2,torque=12")])
    explanation = ps.explain("log.csv")
"""

import ast
from importlib import import_module
from pathlib import Path

__version__ = "0.1.0"

#: public name -> (its module, its name there), from the stub, which type checkers read too
_SOURCES = {
    alias.asname or alias.name: (node.module, alias.name)
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}

__all__ = list(_SOURCES)


def __getattr__(name: str) -> object:
    """Import a public name at its first use."""
    if name not in _SOURCES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module, original = _SOURCES[name]
    value = getattr(import_module(str(module)), original)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names alone."""
    return sorted(__all__)
