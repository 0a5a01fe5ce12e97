# SPDX-License-Identifier: Apache-2.0
"""List the published parameter sets, or print one as a file to start another from."""

from __future__ import annotations

import argparse

NAME = "parameters"
SUMMARY = "list the parameter sets, or print one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("set", metavar="SET|FILE", nargs="?",
                        help="print this set (or check and print this file) as YAML")


def run(options: argparse.Namespace) -> int:
    """Print; raises ParameterError for a set or file that is not usable."""
    from ..files import yaml_text
    from ..parameters import load_parameters, parameter_sets, to_mapping

    if options.set is not None:
        print(yaml_text(to_mapping(load_parameters(options.set))), end="")
        return 0
    names = parameter_sets()
    width = max(map(len, names))
    for name in names:
        arm = load_parameters(name)
        print(f"{name:{width}}  {' '.join(arm.source.split())}")
        for effect in arm.suggested_effects:
            print(f"{'':{width}}  its source also gives --effect {effect}")
    print(f"\nThe default is {names[0]}.")
    return 0
