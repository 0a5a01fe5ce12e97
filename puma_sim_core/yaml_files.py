# SPDX-License-Identifier: Apache-2.0
"""YAML files: read without surprises, written whole or not at all."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

import yaml

from .errors import ParameterError


class _StrictLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """Safe loader that refuses repeated keys and reads 2e-4 as a number, as YAML 1.2 does."""

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key_node, _ in node.value:
            if isinstance(key_node, yaml.ScalarNode):
                key = (key_node.tag, key_node.value)
                if key in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"key '{key_node.value}' stands twice", key_node.start_mark)
                seen.add(key)
        return super().construct_mapping(node, deep=deep)


_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"))


def read_yaml(path: str | os.PathLike, error: type[Exception] = ParameterError):
    """Content of a YAML file; repeated keys are refused.

    Raises
    ------
    error : (ParameterError) the file cannot be read or is not YAML; names the line.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as reason:
        raise error(f"cannot be read ({reason})", where=str(path),
                    expected="a readable YAML file") from None
    try:
        return yaml.load(text, Loader=_StrictLoader)
    except yaml.YAMLError as reason:
        mark = getattr(reason, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        what = getattr(reason, "problem", None) or str(reason)
        raise error(f"not usable as YAML ({what})", where=f"{path}{line}",
                    expected="YAML with each key once") from None


def write_yaml(mapping: Mapping, path: str | os.PathLike,
               error: type[Exception] = ParameterError) -> None:
    """Write a mapping of plain types; an interruption leaves the former file, never a part.

    Raises
    ------
    error : (ParameterError) the file cannot be written.
    """
    path = Path(path)
    text = yaml.safe_dump(dict(mapping), sort_keys=False, allow_unicode=True, width=100)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            # mkstemp makes a file for its owner alone; give it what open() would have given
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(temporary, 0o666 & ~mask)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as reason:
        raise error(f"cannot be written ({reason.strerror})", where=str(path),
                    expected="a path in a folder that can be written") from None
