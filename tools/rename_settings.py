"""Rename the settings of recorded runs: `python tools/rename_settings.py PATH...`.

It renames keys in JSON and YAML files and in the cards of weight files, and writes the readable
card of each weight file it changes. Folders are searched. What was recorded about a run's origin
(`PROVENANCE`) and the bytes of the tensors stay as they are. A second call changes nothing.
"""

from __future__ import annotations

import argparse
import json
import re
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from saver_advisors.policies.files import write_card
from saver_advisors.reporting.provenance import write_json_atomic
from saver_envs.files import written_whole

NEW_NAMES: Final = {
    "arms_apart": "per_arm_critics",
    "start_as_teacher": "warm_start",
    "demonstration_share": "demonstration_fraction",
    "imitation_filter_from": "imitation_filter_start",
    "in_hand_share": "in_hand_probability",
}
PROVENANCE: Final = {"command", "commit", "provenance", "sessions"}
#: A key of a YAML mapping, in block or flow style.
YAML_KEY: Final = re.compile(rf"\b({'|'.join(NEW_NAMES)})(?=\s*:)")


def rename(value: Any) -> Any:
    """Rename the keys of nested mappings, except below `PROVENANCE`.

    :param value: JSON-able
    :return: a copy with the same order of keys
    """
    if isinstance(value, list):
        return [rename(one) for one in value]
    if not isinstance(value, dict):
        return value
    return {
        NEW_NAMES.get(name, name): one if name in PROVENANCE else rename(one)
        for name, one in value.items()
    }


def rename_json(path: Path) -> bool:
    """Rename the settings in a JSON file.

    :param path: the file
    :return: whether the file changed
    """
    content = json.loads(path.read_text(encoding="utf-8"))
    renamed = rename(content)
    if renamed != content:
        write_json_atomic(path, renamed)
    return bool(renamed != content)


def rename_yaml(path: Path) -> bool:
    """Rename the settings in a YAML file and keep its comments.

    :param path: the file
    :return: whether the file changed
    """
    text = path.read_text(encoding="utf-8")
    renamed = YAML_KEY.sub(lambda found: NEW_NAMES[found[1]], text)
    if renamed != text:
        with written_whole(path) as file:
            file.write(renamed.encode("utf-8"))
    return renamed != text


def rename_weights(path: Path) -> bool:
    """Rename the settings in a weight file's card; write its readable card anew.

    :param path: the file, in the safetensors format: the header's size (8 bytes, little-endian),
        the header in JSON, the tensors' bytes
    :return: whether the file changed
    """
    content = path.read_bytes()
    (size,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + size])
    metadata = header.get("__metadata__", {})
    card = json.loads(metadata.get("card", "null"))
    renamed = rename(card)
    if renamed == card:
        return False
    metadata["card"] = json.dumps(renamed, sort_keys=True, allow_nan=False)
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode("utf-8")
    text += b" " * (-len(text) % 8)  # the format aligns the tensors to 8 bytes
    with written_whole(path) as file:
        file.write(struct.pack("<Q", len(text)) + text + content[8 + size :])
    write_card(path)
    return True


RENAMES: Final = {
    ".json": rename_json,
    ".yml": rename_yaml,
    ".yaml": rename_yaml,
    ".safetensors": rename_weights,
}


def files(paths: Sequence[Path]) -> Iterator[Path]:
    """Find the files that can hold settings.

    :param paths: files, and folders to search
    :return: files with an ending in `RENAMES`
    """
    for path in paths:
        found = sorted(path.rglob("*")) if path.is_dir() else [path]
        yield from (one for one in found if one.suffix in RENAMES and one.is_file())


def main(arguments: Sequence[str] | None = None) -> None:
    """Rename the settings in files and folders, and print which files changed.

    :param arguments: of the command line
    """
    parser = argparse.ArgumentParser(description="Rename the settings of recorded runs.")
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    for path in files(parser.parse_args(arguments).paths):
        if RENAMES[path.suffix](path):
            print(path)


if __name__ == "__main__":
    main()
