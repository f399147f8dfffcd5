"""Follow a tutorial in a new folder, line by line as it is written, and time each line:

    python tools/follow_tutorial.py docs/first-policy.md --until "Two arms" --json minutes.json

Shell lines run in one shell, Python blocks as scripts. The wheel of this checkout is installed
where the page installs `saver-envs` from the index. Only the installation needs a network.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import fresh_install

#: A heading, or a block of code with its language.
PART = re.compile(r"^(#+ [^\n]*)$|^```(bash|python)\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: What a page calls the package when it installs it.
PACKAGE = re.compile(r"\bsaver-envs\b")
#: Time of day, and processor time of the shell's programs, after each step.
LAP = 'lap() { echo "$EPOCHREALTIME" >&3; times >&3; }'
#: A line of `times`: minutes and seconds, of users' code and of the system.
TIMES = re.compile(r"(\d+)m([\d.]+)s (\d+)m([\d.]+)s")
#: Variables of whoever starts this, which a reader of the tutorial does not have.
FOREIGN = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME")


@dataclass(frozen=True)
class Step:
    """A line of shell or a block of Python, and the time that it took.

    :param text: as the page has it.
    :param seconds: by the clock.
    :param processor_seconds: of all cores together.
    """

    text: str
    seconds: float
    processor_seconds: float


class TutorialError(Exception):
    """A step of a tutorial fails."""


def steps_of(text: str, until: str | None = None) -> list[tuple[str, str]]:
    """Return the steps of a page in order.

    :param text: Markdown.
    :param until: text of the heading at which to stop; the whole page if None.
    :return: pairs of language (``bash`` or ``python``) and code; a line of shell is one step.
    :raises ValueError: if no heading contains ``until``, or no step comes before it.
    """
    steps: list[tuple[str, str]] = []
    for part in PART.finditer(text):
        heading, language, code = part.groups()
        if heading and until is not None and until in heading:
            break
        if language == "python":
            steps.append((language, code))
        elif language == "bash":
            lines = code.replace("\\\n", " ").splitlines()
            steps += [(language, line) for line in lines if line.strip()]
    else:
        if until is not None:
            raise ValueError(f"until={until!r}: must be part of a heading of the page")
    if not steps:
        raise ValueError("the page has no code to follow")
    return steps


def follow(
    steps: list[tuple[str, str]],
    folder: Path,
    package: Path | None = None,
    variables: Mapping[str, str] = os.environ,
) -> list[Step]:
    """Run steps in a folder.

    :param steps: see :func:`steps_of`.
    :param folder: where they run; empty.
    :param package: a wheel that takes the place of ``saver-envs``; the index's own if None.
    :param variables: of the environment.
    :return: the steps with their times.
    :raises TutorialError: if one fails, naming it.
    """
    script = [LAP, "set -e", "lap"]
    for language, code in steps:
        shown = code if language == "bash" else "python <<'END_OF_BLOCK'\n" + code + "END_OF_BLOCK"
        run = PACKAGE.sub(str(package), shown) if package and "pip install" in shown else shown
        script += [f"echo; echo {shlex.quote('$ ' + run)}", run, "lap"]
    clean = {name: value for name, value in variables.items() if name not in FOREIGN}
    with tempfile.TemporaryFile("w+") as laps:
        command = ["bash", "-c", 'exec 3>&"$0"; eval "$1"', str(laps.fileno()), "\n".join(script)]
        status = subprocess.run(
            command,
            cwd=folder,
            env=clean,
            stdin=subprocess.DEVNULL,
            pass_fds=(laps.fileno(),),
            check=False,
        ).returncode
        laps.seek(0)
        times = _laps(laps.read())
    if status:
        raise TutorialError(f"status {status}: {steps[len(times) - 1][1]}")
    return [
        Step(code.strip(), round(after[0] - before[0], 1), round(after[1] - before[1], 1))
        for (_, code), (before, after) in zip(steps, pairwise(times), strict=True)
    ]


def _laps(text: str) -> list[tuple[float, float]]:
    """Return the time of day and the processor time of all programs so far, after each step."""
    lines = text.splitlines()
    found = []
    for moment, _, programs in zip(lines[::3], lines[1::3], lines[2::3], strict=True):
        matched = TIMES.fullmatch(programs)
        assert matched is not None, programs
        minutes, seconds, system_minutes, system_seconds = map(float, matched.groups())
        used = 60 * (minutes + system_minutes) + seconds + system_seconds
        found.append((float(moment.replace(",", ".")), used))
    return found


def main() -> int:
    """Follow a page, print a table of its steps, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("page", type=Path, help="Markdown")
    parser.add_argument("--until", metavar="HEADING", help="stop before this heading")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the times to a file")
    args = parser.parse_args()
    steps = steps_of(args.page.read_text(encoding="utf-8"), args.until)
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch) / "work"
        work.mkdir()
        try:
            done = follow(steps, work, fresh_install.build(Path(scratch) / "dist"))
        except TutorialError as error:
            print(f"the tutorial stops: {error}", file=sys.stderr)
            return 1
    print("\n  clock  processor  step")
    for step in done:
        first, *more = step.text.splitlines()
        print(
            f"{step.seconds:7.1f}  {step.processor_seconds:9.1f}  {first}{' ...' if more else ''}"
        )
    minutes = sum(step.seconds for step in done) / 60
    used = sum(step.processor_seconds for step in done) / 60
    print(f"{minutes:.1f} minutes by the clock, {used:.1f} of processor time")
    if args.json is not None:
        record = {"page": str(args.page), "until": args.until, "minutes": minutes}
        record |= {"processor_minutes": used, "steps": [asdict(step) for step in done]}
        args.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
