# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""``metadata.yaml`` of a rosbag2 directory, version 9 (ROS 2 Jazzy)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag.messages import Topic, qos, type_hash

NAME = "metadata.yaml"
VERSION = 9
_ROOT = "rosbag2_bagfile_information"
_KINDS = {dict: "a mapping", str: "a text", int: "a whole number", list: "a list"}


def information(
    topics: Sequence[tuple[Topic, str, int]], last_ns: int, file_name: str | None = None
) -> dict[str, object]:
    """Every key that rosbag2 reads at version 9, in the order in which it writes them.

    Parameters
    ----------
    topics : each with its name in the bag and the number of its messages.
    last_ns : time of the last message [ns]; the first is at 0.
    file_name : the MCAP file. The copy inside that file has none: rosbag2 puts the name of the file
        that it opened there, and equal sessions give equal files whatever their names.
    """
    total = sum(count for *_, count in topics)
    start, duration = {"nanoseconds_since_epoch": 0}, {"nanoseconds": last_ns}
    # copies: the same object twice would be written as a YAML alias
    file = {"path": file_name, "starting_time": dict(start), "duration": dict(duration), "message_count": total}
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": total,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos(topic),
                    "type_description_hash": type_hash(topic.type),
                },
                "message_count": count,
            }
            for topic, name, count in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name] if file_name else [],
        "files": [file] if file_name else [],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def dump(content: dict[str, object]) -> str:
    """YAML text, keys in their given order."""
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def write(directory: Path, content: dict[str, object]) -> None:
    """Write ``metadata.yaml`` whole or not at all; ``OSError`` if it cannot be written."""
    part = directory / (NAME + ".part")
    part.write_text(dump({_ROOT: content}), encoding="utf-8")
    part.replace(directory / NAME)


def read(directory: Path) -> tuple[Path, dict[str, int]]:
    """The MCAP file and its number of messages by topic; `BagError` names the key that is missing or wrong."""
    path = directory / NAME
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BagError(f"cannot be read ({error.strerror})", where=path) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BagError(f"is not YAML ({first})", where=path, expected="a rosbag2 bag") from error
    content = _item(content, _ROOT, dict, path)
    storage = _item(content, "storage_identifier", str, path)
    if storage != "mcap":
        raise BagError(f"storage_identifier is {storage!r}", where=path, expected="'mcap'")
    if _item(content, "version", int, path) > VERSION:
        raise BagError(f"version is {content['version']}", where=path, expected=f"at most {VERSION}")
    if content.get("compression_mode"):
        mode = f"compression_mode is {content['compression_mode']!r}"
        raise BagError(mode, where=path, expected="a bag without compression by rosbag2")
    files = _item(content, "relative_file_paths", list, path)
    if len(files) != 1 or not isinstance(files[0], str) or Path(files[0]).name != files[0]:
        raise BagError(f"relative_file_paths is {files!r}", where=path, expected="one file in this directory")
    counts = {
        _item(_item(entry, "topic_metadata", dict, path), "name", str, path): _item(entry, "message_count", int, path)
        for entry in _item(content, "topics_with_message_count", list, path)
    }
    return directory / files[0], counts


def _item(mapping: object, key: str, kind: type, path: Path) -> Any:
    value = mapping.get(key) if isinstance(mapping, dict) else None
    if not isinstance(value, kind):
        found = "is missing" if value is None else f"is {value!r:.60}"
        raise BagError(f"{key} {found}", where=path, expected=_KINDS[kind])
    return value
