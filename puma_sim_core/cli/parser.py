# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A parser of command lines that shows the usage of the subcommand itself and proposes the nearest name."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from puma_sim_core.errors import one_of

#: argparse's words for a value that is none of the choices; newer Pythons leave out the quotes of the choices
_CHOICE = re.compile(r"(?P<before>.*)invalid choice: '(?P<value>.*)' \(choose from (?P<choices>.*)\)", re.S)
_OPTION = re.compile(r"--[a-z][a-z-]*")


class Parser(argparse.ArgumentParser):
    """As argparse's, without abbreviations, with help as it is written."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        settings = {"formatter_class": argparse.RawDescriptionHelpFormatter, **settings, "allow_abbrev": False}
        super().__init__(*arguments, **settings)
        self._leads_on = False

    def add_subparsers(self, **settings: Any) -> Any:  # type: ignore[override]
        """As argparse's; options are then those of the parsers below."""
        self._leads_on = True
        return super().add_subparsers(**settings)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Refuse what is not known here: the parser above would show its own usage."""
        if not self._leads_on:
            self._check_options([] if args is None else args)
        found, left = super().parse_known_args(args, namespace)
        if left:
            self.error(f"'{left[0]}' is one argument too many")
        return found, left

    def _check_options(self, args: Sequence[str]) -> None:
        """Refuse an unknown option, before it is seen that another one is missing in its place."""
        options = sorted(set(_OPTION.findall(self.format_help())))
        for text in args:
            if text == "--":
                return
            name = text.partition("=")[0]
            if name.startswith("--") and name not in options:
                self.error(f"unknown option '{name}'; expected {one_of(name, options, f'`{self.prog} --help`')}")

    def error(self, message: str) -> NoReturn:
        """End with the usage and what is wrong; argparse lists all choices, however many."""
        found = _CHOICE.fullmatch(message)
        if found is not None:
            choices = [each.strip().strip("'") for each in found["choices"].split(",")]
            expected = one_of(found["value"], choices, f"`{self.prog} --help`")
            message = f"{found['before']}'{found['value']}'; expected {expected}"
        super().error(message)
