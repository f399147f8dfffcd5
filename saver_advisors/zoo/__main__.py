"""`python -m saver_advisors.zoo train|enjoy ...`: RL Zoo's own programs, which then know ours."""

from __future__ import annotations

import sys

from saver_advisors.zoo.manager import enjoy, train

USAGE = "usage: python -m saver_advisors.zoo {train,enjoy} [RL Zoo's arguments]"


def main(words: list[str]) -> None:
    """Hand the arguments over.

    :param words: ``train`` or ``enjoy``, then RL Zoo's arguments
    """
    if words[:1] == ["train"]:
        vec_env = any(word.split("=")[0] == "--vec-env" for word in words)
        train(words[1:], **({"vec_env_class": None} if vec_env else {}))
    elif words[:1] == ["enjoy"]:
        enjoy(words[1:])
    else:
        sys.exit(USAGE)


if __name__ == "__main__":
    main(sys.argv[1:])
