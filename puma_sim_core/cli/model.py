# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Write a model file: the parameters of an arm and effects in one, for --model."""

from __future__ import annotations

import argparse

from puma_sim_core.cli.arguments import add_plant_arguments, input_files, plant_of
from puma_sim_core.cli.output import check_output, output_file
from puma_sim_core.errors import ModelError

NAME = "model"
SUMMARY = "write parameters and effects as one model file"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_plant_arguments(parser)
    parser.add_argument("--out", metavar="FILE", default="-", help="the file to write (default -, standard output)")


def run(options: argparse.Namespace) -> int:
    """Write; raises ParameterError or ModelError."""
    from puma_sim_core.files import yaml_text

    check_output(options.out, input_files(options))
    text = yaml_text(plant_of(options).to_mapping())
    with output_file(options.out, ModelError) as file:
        file.write(text)
    return 0
