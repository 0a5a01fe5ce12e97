# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Files that appear complete or not at all, and YAML with each key once."""

import io
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import yaml

from puma_sim_core.errors import ParameterError, PumaSimError


@contextmanager
def whole_bytes(path: str | os.PathLike[str], error: type[PumaSimError]) -> Iterator[BinaryIO]:
    """A file of bytes to write; it takes the place of `path` when the block ends without an error.

    Where `path` is a link, the file that it leads to is replaced; a device or a pipe, which
    nothing may take the place of, is written to.

    Raises error: the folder is missing or cannot be written, or the disk is full; names the path.
    """
    given, path = path, Path(os.path.realpath(path))
    try:
        if is_special(given):
            with open(given, "wb") as file:
                yield file
            return
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                yield file
            # mkstemp makes a file for its owner alone; give it what open() would have given
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(temporary, 0o666 & ~mask)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except BrokenPipeError:
        raise
    except OSError as reason:
        what, expected = f"cannot be written ({reason.strerror})", "a path in a folder that can be written"
        raise error(what, where=str(given), expected=expected) from None


@contextmanager
def whole_file(path: str | os.PathLike[str], error: type[PumaSimError]) -> Iterator[TextIO]:
    """A text file to write, as `whole_bytes` is one of bytes."""
    with whole_bytes(path, error) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        yield text
        text.detach()  # with all that was written


def is_special(path: str | os.PathLike[str]) -> bool:
    """Whether a path is there and is neither a file nor a folder: a device, a pipe."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


class _StrictLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Safe loader that refuses repeated keys and reads 2e-4 as the number that YAML 1.2 has."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, str) and key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key '{key}' stands twice", key_node.start_mark)
            seen.add(key if isinstance(key, str) else None)
        return super().construct_mapping(node, deep=deep)


_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def parse_yaml(text: str, where: str, error: type[PumaSimError] = ParameterError) -> Any:
    """Content of a YAML text; `where` names it in errors.

    Raises error: not YAML, or a key twice; names the line.
    """
    try:
        return yaml.load(text, Loader=_StrictLoader)
    except yaml.YAMLError as reason:
        mark = getattr(reason, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        what = getattr(reason, "problem", None) or str(reason)
        what = f"not usable as YAML ({what})"
        raise error(what, where=f"{where}{line}", expected="YAML with each key once") from None


def read_yaml(path: str | os.PathLike[str], error: type[PumaSimError] = ParameterError) -> Any:
    """Content of a YAML file.

    Raises error: the file cannot be read, is not YAML, or has a key twice; names the line.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as reason:
        raise error(
            f"cannot be read ({getattr(reason, 'strerror', None) or reason})",
            where=str(path),
            expected="a readable YAML file",
        ) from None
    return parse_yaml(text, str(path), error)


def places_of_keys(text: str) -> dict[str, str]:
    """Line and column, as "line 3, column 5", of each key of a YAML text; keys of mappings in one another have a point
    between them, such as ``body.mass.value``."""
    found: dict[str, str] = {}

    def walk(node: yaml.Node | None, prefix: str) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                name, mark = f"{prefix}{key.value}", key.start_mark
                found[name] = f"line {mark.line + 1}, column {mark.column + 1}"
                walk(value, f"{name}.")

    walk(yaml.compose(text, Loader=_StrictLoader), "")
    return found


def yaml_text(mapping: Mapping[str, Any]) -> str:
    """YAML of a mapping of plain types, keys in their order; the same mapping, the same bytes."""
    return yaml.safe_dump(dict(mapping), sort_keys=False, allow_unicode=True, width=100)


def write_yaml(
    mapping: Mapping[str, Any], path: str | os.PathLike[str], error: type[PumaSimError] = ParameterError
) -> None:
    """Write a mapping of plain types; raises `error` as `whole_file` does."""
    with whole_file(path, error) as file:
        file.write(yaml_text(mapping))
