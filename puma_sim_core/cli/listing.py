# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""List the published parameter sets, the mechanisms that `explain` knows, and the effects, which are what a real
drive does and the thesis's model lacks.

  puma-sim list                       all of them
  puma-sim list mechanisms            mechanisms alone
  puma-sim list pendulum > mine.yaml  one mechanism as a file, to start another from
  puma-sim list coulomb_friction      one effect
  puma-sim list bejczy > mine.yaml    one set as a parameter file, to start another from
"""

from __future__ import annotations

import argparse
import itertools
import textwrap
from typing import TYPE_CHECKING

from puma_sim_core.cli.arguments import Command
from puma_sim_core.errors import ParameterError, one_of

if TYPE_CHECKING:
    from puma_sim_core.effects import Kind, Parameter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "name",
        metavar="NAME",
        nargs="?",
        help="mechanisms, or one effect, mechanism, set or parameter file (checked, as YAML)",
    )


def run(options: argparse.Namespace) -> int:
    """Print; raises ParameterError for an unknown name or a file that is not usable."""
    from pathlib import Path

    from puma_sim_core.arm.parameters import parameter_sets
    from puma_sim_core.effects import KINDS
    from puma_sim_core.plant.mechanism_file import mechanism_names
    from puma_sim_core.resources import config_path

    name, sets, machines = options.name, parameter_sets(), mechanism_names()
    if name is None:
        print("Parameter sets (--parameters), the default one first\n")
        print("\n".join(map(_set_text, sets)))
        print("\nMechanisms (--plant), the default one first\n")
        print("\n".join(map(_mechanism_text, machines)))
        print("\nEffects (--effect)\n")
        print("\n\n".join(map(_effect_text, (kind for kind in KINDS.values() if kind.number == 1))))
    elif name == "mechanisms":
        print("\n".join(map(_mechanism_text, machines)))
    elif name in machines:
        print(config_path("mechanisms", f"{name}.yaml").read_text(encoding="utf-8"), end="")
    elif name in KINDS:
        print(_effect_text(KINDS[KINDS[name].first]))
    elif name in sets or Path(name).exists():
        print(_parameter_file(name), end="")
    else:
        names = ["mechanisms", *sets, *machines, *KINDS]
        expected = f"a parameter file, or {one_of(name, names, '`puma-sim list`')}"
        raise ParameterError(f"'{name}' is not known", expected=expected)
    return 0


def _parameter_file(name: str) -> str:
    from puma_sim_core.arm.parameters import load_parameters, to_mapping
    from puma_sim_core.files import yaml_text

    return yaml_text(to_mapping(load_parameters(name)))


def _set_text(name: str) -> str:
    from puma_sim_core.arm.parameters import load_parameters

    arm = load_parameters(name)
    lines = [name, f"  {' '.join(arm.source.split())}"]
    lines += [f"  the source has besides: --effect {effect}" for effect in arm.suggested_effects]
    return "\n".join(lines)


def _mechanism_text(name: str) -> str:
    from puma_sim_core.plant.mechanism_file import load_mechanism
    from puma_sim_core.resources import config_path

    m = load_mechanism(name)
    text = config_path("mechanisms", f"{name}.yaml").read_text(encoding="utf-8")
    comment = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    words = " ".join(line.lstrip("# ") for line in comment if "SPDX" not in line)
    passive = f", joint {m.driven.index(False) + 1} passive" if False in m.driven else ""
    head = f"{name}  ({m.joints} joint{'s' * (m.joints > 1)}{passive}; {m.position_unit})"
    return "\n".join([head, *textwrap.wrap(words, 100, initial_indent="  ", subsequent_indent="  ")])


def _effect_text(kind: Kind) -> str:
    keys = ["joint=1..3"] if kind.per_joint else []
    keys += [f"{p.name}=..." for p in kind.parameters if _is_required(p)]
    lines = [
        f"{kind.name}  (acts on: {kind.acts})",
        f"  {kind.sentence}",
        f"  {kind.equation}",
        f"  --effect {kind.name}:{','.join(keys)}",
    ]
    if kind.further:
        lines.append(f"    up to {kind.most} on a joint: {', '.join(kind.names)}")
    names = [p.name for p in kind.parameters]
    units = [f"[{p.unit}]" for p in kind.parameters]
    for p, unit in zip(kind.parameters, units):
        source = "taken from the arm" if p.default is None else f"{p.default:g}"
        start = "" if _is_required(p) else f"; {source} if not given"
        lines.append(
            f"    {p.name:{max(map(len, names))}}  {unit:{max(map(len, units))}}  "
            f"{p.low:g} to {p.high:g}: {p.meaning}{start}"
        )
    return "\n".join(lines)


def _is_required(parameter: Parameter) -> bool:
    return parameter.default is None and parameter.from_arm is None


COMMAND = Command("list", "list parameter sets, mechanisms and effects", __doc__, add_arguments, run)
