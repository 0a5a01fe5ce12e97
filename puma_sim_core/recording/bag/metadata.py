# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""``metadata.yaml`` of a rosbag2 directory, version 9 (ROS 2 Jazzy)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag.messages import qos, type_hash
from puma_sim_core.recording.topics import Topic

NAME = "metadata.yaml"
VERSION = 9
_ROOT = "rosbag2_bagfile_information"
_KINDS = {dict: "a mapping", str: "a text", int: "a whole number", list: "a list"}


class FileInformation(NamedTuple):
    """What an MCAP file of a bag holds."""

    path: str  #: its name in the bag's directory
    first_ns: int  #: time at which it begins [ns]
    last_ns: int  #: time of its last message [ns]
    counts: Mapping[Topic, int]  #: number of its messages by topic


def information(names: Mapping[Topic, str], files: Sequence[FileInformation], *, listed: bool) -> dict[str, object]:
    """Every key that rosbag2 reads at version 9, in the order in which it writes them.

    Parameters
    ----------
    names : full name of each topic.
    files : the MCAP files in their order.
    listed : name the files, as ``metadata.yaml`` does. The copy inside a file describes that file and names none:
        rosbag2 puts the name of the file that it opened there, and equal sessions give equal files whatever the names.
    """
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span(files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos(topic),
                    "type_description_hash": type_hash(topic.type),
                },
                "message_count": sum(file.counts[topic] for file in files),
            }
            for topic, name in names.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.path for file in files if listed],
        "files": [_entry(file) for file in files if listed],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _span(files: Sequence[FileInformation]) -> dict[str, object]:
    """Time and number of the messages of consecutive files; new objects, since one twice would be a YAML alias."""
    first = files[0].first_ns
    return {
        "duration": {"nanoseconds": files[-1].last_ns - first},
        "starting_time": {"nanoseconds_since_epoch": first},
        "message_count": sum(sum(file.counts.values()) for file in files),
    }


def _entry(file: FileInformation) -> dict[str, object]:
    span = _span([file])
    return {"path": file.path, **{key: span[key] for key in ("starting_time", "duration", "message_count")}}


def dump(content: dict[str, object]) -> str:
    """YAML text, keys in their given order."""
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def write(directory: Path, content: dict[str, object]) -> None:
    """Write ``metadata.yaml`` whole or not at all; ``OSError`` if it cannot be written."""
    part = directory / (NAME + ".part")
    part.write_text(dump({_ROOT: content}), encoding="utf-8")
    part.replace(directory / NAME)


def read(directory: Path) -> tuple[list[Path], dict[str, int]]:
    """The MCAP files and their number of messages by topic; `BagError` names the key that is missing or wrong."""
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
    if not files or not all(isinstance(file, str) and Path(file).name == file for file in files):
        raise BagError(f"relative_file_paths is {files!r}", where=path, expected="names of files in this directory")
    counts = {
        _item(_item(entry, "topic_metadata", dict, path), "name", str, path): _item(entry, "message_count", int, path)
        for entry in _item(content, "topics_with_message_count", list, path)
    }
    return [directory / file for file in files], counts


def _item(mapping: object, key: str, kind: type, path: Path) -> Any:
    value = mapping.get(key) if isinstance(mapping, dict) else None
    if not isinstance(value, kind):
        found = "is missing" if value is None else f"is {value!r:.60}"
        raise BagError(f"{key} {found}", where=path, expected=_KINDS[kind])
    return value
