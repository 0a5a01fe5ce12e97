# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""JSON that a person can read and a program can compare: the same content, the same bytes."""

import json
from typing import Any


def json_text(content: Any, *, sort_keys: bool = False) -> str:
    """JSON of plain values, with a line feed at its end.

    Mappings and lists of mappings or of lists go over many lines, everything else stands in one.
    Numbers have as many digits as tell them from their neighbours.

    Parameters
    ----------
    content : mappings, lists, texts, numbers, None.
    sort_keys : keys in alphabetical order; else in the order of the mappings.

    Raises
    ------
    ValueError : a number is not finite, which JSON cannot hold.
    """
    return _text(content, "", sort_keys) + "\n"


def _text(value: Any, indent: str, sort_keys: bool) -> str:
    inner = indent + " "
    if isinstance(value, dict) and value:
        names = sorted(value) if sort_keys else value
        lines = [f"{inner}{_flat(name, sort_keys)}: {_text(value[name], inner, sort_keys)}" for name in names]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and value and isinstance(value[0], (dict, list)):
        lines = [inner + _text(item, inner, sort_keys) for item in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return _flat(value, sort_keys)


def _flat(value: Any, sort_keys: bool) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, sort_keys=sort_keys)
