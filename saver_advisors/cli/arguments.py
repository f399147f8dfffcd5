"""Arguments that several commands share, and the types that parse them."""

from __future__ import annotations

import argparse
import contextlib
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes


def env_id(text: str) -> str:
    """Parse a registered id for argparse.

    :param text: as given
    :return: the id; ``module:Id`` keeps its module, which registers it wherever it is read
    """
    from saver_envs.registration import ENVIRONMENTS, PACKAGE, row_of

    name = text.removeprefix(f"{PACKAGE}:")
    try:
        row_of(name)
    except ValueError as error:
        wrong = str(error) if ":" in name else unknown("environment", text, ENVIRONMENTS)
        raise argparse.ArgumentTypeError(wrong) from None
    return name


def teacher(text: str) -> str:
    """Check the name of a teacher for argparse; the name of code is not imported.

    :param text: as given
    :return: the same
    """
    from saver_advisors.policies.scripted import EXPERT
    from saver_advisors.pretrained import shipped_policies

    names = [*shipped_policies(), EXPERT]
    if text not in names and ":" not in text and not os.path.exists(text):
        message = unknown("teacher", text, names)
        raise argparse.ArgumentTypeError(
            f"{message}; or give the path of a .safetensors file, of a run's folder or of an SB3 "
            "zip file; or MODULE:FUNCTION"
        )
    return text


def arm(text: str) -> str:
    """Check the name of an arm that can be modelled, for argparse.

    :param text: as given
    :return: the same
    """
    from saver_envs.modelling.arms import ARMS

    if text not in ARMS:
        raise argparse.ArgumentTypeError(unknown("arm", text, ARMS))
    return text


def at_least(least: int) -> Any:
    """Make an argparse type for integers with a lower bound.

    :param least: smallest allowed value
    :return: the type
    """

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
        if value < least:
            raise argparse.ArgumentTypeError(f"{value} is too small: must be {least} or more")
        return value

    return read


def positive_seconds(text: str) -> float:
    """Parse a positive duration for argparse.

    :param text: as given
    :return: seconds
    """
    return positive(text, "seconds")


def positive(text: str, unit: str = "") -> float:
    """Parse a positive number for argparse.

    :param text: as given
    :param unit: what the messages call it, such as seconds
    :return: the number
    """
    try:
        value = float(text)
    except ValueError:
        of_unit = f" of {unit}" if unit else ""
        raise argparse.ArgumentTypeError(f"{text!r} is not a number{of_unit}") from None
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: must be more than 0 {unit}".rstrip())
    return value


def new_file(*suffixes: str) -> Any:
    """Make an argparse type for a file to write, checked before the work starts.

    :param suffixes: allowed file name extensions; all where none is given
    :return: the type
    """

    def read(text: str) -> Path:
        path = Path(text)
        if suffixes and path.suffix.lower() not in suffixes:
            raise argparse.ArgumentTypeError(f"{text!r} must end in {' or '.join(suffixes)}")
        if path.is_dir():
            raise argparse.ArgumentTypeError(f"{text!r} is a folder: give the name of a file")
        if not path.parent.is_dir():
            raise argparse.ArgumentTypeError(f"the folder {str(path.parent)!r} does not exist")
        if path.exists() and not os.access(path, os.W_OK):
            raise argparse.ArgumentTypeError(f"the file {text!r} cannot be written to")
        _check_writable(path.parent)
        return path

    return read


def new_folder(text: str) -> Path:
    """Parse the path of a folder to write to, which may not be a file.

    :param text: as given
    :return: the path
    """
    path = Path(text)
    if path.exists() and not path.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is a file, not a folder")
    _check_writable(path)
    return path


def _check_writable(folder: Path) -> None:
    """Check that files can be written to a folder, or to the one that it will be created in."""
    folder = next(one for one in (folder, *folder.absolute().parents) if one.is_dir())
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        message = f"the folder {str(folder)!r} cannot be written to ({error.strerror})"
        raise argparse.ArgumentTypeError(message) from None


def settings(pairs: Sequence[str] | None, argument: str) -> dict[str, Any]:
    """Parse ``name=value`` words; values are YAML, and 1e-3 is a number.

    :param pairs: the words
    :param argument: name of the argument, for error messages
    :return: the values by name
    :raises UsageError: for a word of another form
    """
    import yaml

    values: dict[str, Any] = {}
    for pair in pairs or ():
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise UsageError(f"argument {argument}: {pair!r} must read name=value")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise UsageError(
                f"argument {argument}: {pair!r} has a value that is not YAML"
            ) from error
        if isinstance(value, str):
            with contextlib.suppress(ValueError):
                value = float(value)
        values[name] = value
    return values


def add(parser: Any, name: str, text: str, default: Any = None, **options: Any) -> None:
    """Add an argument.

    :param parser: an argparse parser or group
    :param name: such as ``--policy``
    :param text: help text, to which the default value is added
    :param default: its default value, if there is one to show
    :param options: further arguments of argparse
    """
    shown = " ".join(map(str, default)) if isinstance(default, list) else default
    text = text if shown in (None, "") else f"{text} (default: {shown})".lstrip()
    parser.add_argument(name, default=default, help=text, **options)


def add_flag(parser: Any, name: str, text: str) -> None:
    """Add an option without a value.

    :param parser: an argparse parser or group
    :param name: such as ``--resume``
    :param text: help text
    """
    parser.add_argument(name, action="store_true", help=text)


def add_count(
    parser: Any, name: str, default: int | None, text: str, *, least: int = 1, metavar: str = "N"
) -> None:
    """Add an option for an integer with a lower bound.

    :param parser: an argparse parser or group
    :param name: such as ``--episodes``
    :param default: its default value, which the help text shows
    :param text: help text
    :param least: smallest allowed value
    :param metavar: name of the value in the help text
    """
    add(parser, name, text, default, type=at_least(least), metavar=metavar)


def add_seconds(
    parser: Any, name: str, text: str, default: float | None = None, metavar: str = "SECONDS"
) -> None:
    """Add an option for a positive duration.

    :param parser: an argparse parser or group
    :param name: such as ``--time-limit``
    :param text: help text
    :param default: its default value, which the help text shows
    :param metavar: name of the value in the help text
    """
    text = text if default is None else f"{text} (default: {default:g})"
    parser.add_argument(name, type=positive_seconds, default=default, metavar=metavar, help=text)


def add_settings(parser: Any, name: str, text: str) -> None:
    """Add an option for ``NAME=VALUE`` words, for :func:`settings`.

    :param parser: an argparse parser or group
    :param name: such as ``--set``
    :param text: help text
    """
    parser.add_argument(name, nargs="+", action="extend", metavar="NAME=VALUE", help=text)


def add_several(
    parser: Any, name: str, kind: Any, default: Sequence[Any], text: str, metavar: str = "N"
) -> None:
    """Add an option for one or more values.

    :param parser: an argparse parser or group
    :param name: such as ``--seeds``
    :param kind: argparse type of a value
    :param default: the default values, which the help text shows
    :param text: help text
    :param metavar: name of a value in the help text
    """
    add(parser, name, text, list(default), nargs="+", type=kind, metavar=metavar)


def add_file(
    parser: Any, name: str, text: str, *suffixes: str, metavar: str = "FILE", **options: Any
) -> None:
    """Add an option for a file to write.

    :param parser: an argparse parser or group
    :param name: such as ``--video``
    :param text: help text
    :param suffixes: allowed file name extensions
    :param metavar: name of the value in the help text
    :param options: further arguments of argparse
    """
    parser.add_argument(name, type=new_file(*suffixes), metavar=metavar, help=text, **options)


def add_path(parser: Any, name: str, text: str, *, metavar: str = "FILE", **options: Any) -> None:
    """Add an argument for a file or folder to read.

    :param parser: an argparse parser or group
    :param name: such as ``--weights``
    :param text: help text
    :param metavar: name of the value in the help text
    :param options: further arguments of argparse
    """
    parser.add_argument(name, type=Path, metavar=metavar, help=text, **options)


def add_folder(parser: Any, name: str, text: str, **options: Any) -> None:
    """Add an option for a folder to write to.

    :param parser: an argparse parser or group
    :param name: such as ``--output``
    :param text: help text
    :param options: further arguments of argparse
    """
    parser.add_argument(name, type=new_folder, metavar="DIR", help=text, **options)


def add_cache(parser: Any, name: str, what: str, text: str) -> None:
    """Add an option for a folder of files that are kept, in the user's cache by default.

    :param parser: an argparse parser or group
    :param name: such as ``--cache``
    :param what: name of the folder in the cache
    :param text: help text
    """
    from saver_envs.files import cache_folder

    add(parser, name, text, cache_folder(what), type=Path, metavar="DIR")


def add_pose_cache(parser: Any) -> None:
    """Add ``--cache``, the folder of rendered pictures."""
    add_cache(parser, "--cache", "pose", "folder of rendered pictures")


def add_peer_cache(parser: Any) -> None:
    """Add ``--peer-cache``, the folder of the suites that ours is compared with."""
    add_cache(parser, "--peer-cache", "peers", "folder of the peers' virtual environments")


def add_figure(parser: Any, name: str, text: str) -> None:
    """Add an option for a figure to write: PNG, SVG or PDF.

    :param parser: an argparse parser or group
    :param name: such as ``--figure``
    :param text: help text
    """
    add_file(parser, name, text, ".png", ".svg", ".pdf", metavar="FIG.png")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json FILE``, which every measuring command accepts."""
    text = "also write the results as JSON, with command, commit, seed, versions and machine"
    add_file(parser, "--json", text, ".json")


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add ``--threads N``, which every training command accepts."""
    add_count(parser, "--threads", 1, "cores per run, for simulation and networks")


def add_table(parser: argparse.ArgumentParser) -> None:
    """Add ``--table [FILE]``, for commands that write a Markdown page."""
    usual = f"{parser.prog.split()[-1]}.md"
    text = f"also write the results as a Markdown page (default name: {usual})"
    add_file(parser, "--table", text, ".md", nargs="?", const=usual)


def add_page(parser: argparse.ArgumentParser) -> None:
    """Add ``--table``, ``--from`` and ``--json``, for commands that measure and render a page."""
    add_table(parser)
    text = "render the results of an earlier --json instead of measuring"
    add_path(parser, "--from", text, dest="from_json")
    add_json(parser)


def add_env(
    parser: argparse.ArgumentParser, text: str = "see `saver envs`", required: bool = False
) -> None:
    """Add ``--env ID``.

    :param parser: an argparse parser
    :param text: help text
    :param required: whether the command needs it
    """
    add(parser, "--env", text, type=env_id, metavar="ID", required=required)


def add_env_kwargs(parser: argparse.ArgumentParser) -> None:
    """Add ``--env-kwargs name=value ...`` and ``--randomization``, which adds one of them."""
    text = "keyword arguments of the environment, such as rated=true object_size=0.07"
    add_settings(parser, "--env-kwargs", text)
    text = "what differs between episodes: none, mild, wide, held-out:NAME or held-out:all; "
    text += "short for --env-kwargs randomization=NAME"
    kind = "randomization={}".format
    names = {"dest": "env_kwargs", "metavar": "NAME"}
    add(parser, "--randomization", text, action="append", type=kind, **names)


def checked_env_kwargs(
    env: str, pairs: Sequence[str] | None, argument: str = "--env-kwargs"
) -> dict[str, Any]:
    """Parse the keyword arguments of an environment, and check that it accepts them.

    :param env: id of the environment
    :param pairs: ``name=value`` words
    :param argument: name of the argument, for error messages
    :return: the keyword arguments
    :raises UsageError: for an argument that the environment rejects
    """
    from saver_envs.registration import make_episodes

    values = settings(pairs, argument)
    if values:
        with user_mistakes(f"argument {argument}"):
            make_episodes(env, **values)
    return values


def write_json(path: Path | None, data: Mapping[str, Any]) -> None:
    """Write results with their provenance; do nothing without a path.

    :param path: of the file, or None
    :param data: JSON-able results; a provenance of an earlier time among them is kept
    """
    from saver_advisors.reporting.provenance import provenance, write_json_atomic

    if path is not None:
        origin = data.get("provenance") or provenance()
        write_json_atomic(path, {**data, "provenance": origin})
        print(f"wrote {path}")
