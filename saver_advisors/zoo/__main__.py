"""`python -m saver_advisors.zoo train|enjoy ...`: RL Zoo's programs, with our algorithms."""

from __future__ import annotations

import sys

from saver_advisors.zoo.manager import enjoy, train

PROGRAMS = {"train": train, "enjoy": enjoy}


def main(words: list[str]) -> None:
    """Run one of RL Zoo's programs.

    :param words: ``train`` or ``enjoy``, then RL Zoo's arguments.
    """
    if not words or words[0] not in PROGRAMS:
        sys.exit("usage: python -m saver_advisors.zoo {train,enjoy} [RL Zoo's arguments]")
    PROGRAMS[words[0]](words[1:])


if __name__ == "__main__":
    main(sys.argv[1:])
