# SPDX-License-Identifier: Apache-2.0
"""List what a real drive does beyond the thesis's model, and how to ask for it with --effect."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..errors import ParameterError

if TYPE_CHECKING:
    from ..effects import Kind, Parameter

NAME = "effects"
SUMMARY = "list the effects: equations, parameters, units, bounds"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("name", metavar="NAME", nargs="?", help="this effect only")


def run(options: argparse.Namespace) -> int:
    """Print; raises ParameterError for an unknown name."""
    from ..effects import KINDS

    if options.name is not None and options.name not in KINDS:
        raise ParameterError(f"unknown effect '{options.name}'",
                             expected=f"one of {', '.join(KINDS)}")
    kinds = [kind for kind in KINDS.values() if options.name in (None, kind.name)]
    print("\n\n".join(map(_text, kinds)))
    return 0


def _text(kind: Kind) -> str:
    keys = ["joint=1..3"] if kind.per_joint else []
    keys += [f"{p.name}=..." for p in kind.parameters if _is_required(p)]
    lines = [f"{kind.name}  (acts on: {kind.acts})", f"  {kind.sentence}",
             f"  {kind.equation}", f"  --effect {kind.name}:{','.join(keys)}".rstrip(":")]
    names = [p.name for p in kind.parameters]
    units = [f"[{p.unit}]" for p in kind.parameters]
    for p, unit in zip(kind.parameters, units):
        start = ("" if _is_required(p) else f"; {p.default:g} if not given"
                 if p.default is not None else "; taken from the arm if not given")
        lines.append(f"    {p.name:{max(map(len, names))}}  {unit:{max(map(len, units))}}  "
                     f"{p.low:g} to {p.high:g}: {p.meaning}{start}")
    return "\n".join(lines)


def _is_required(parameter: Parameter) -> bool:
    return parameter.default is None and parameter.from_arm is None
