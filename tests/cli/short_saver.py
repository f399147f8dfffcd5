"""`saver` whose commands take seconds: the program of the notebooks' tests, and what it adds."""

from __future__ import annotations

import sys

from commands import TINY

#: What a snippet's command gets on top, so that it takes seconds: the last value of an argument
#: counts.
SHORTER = {
    "envs": [],
    "evaluate": ["--episodes", "2", "--env-kwargs", "max_episode_steps=10"],
    "train": [
        "--steps",
        "40",
        "--no-progress",
        "--env-kwargs",
        "max_episode_steps=10",
        "--set",
        *TINY,
    ],
    "curves": [],
    "export": ["--episodes", "2"],
    "benchmark run": [
        *("--steps", "40", "--eval-every", "20", "--eval-episodes", "2", "--report-episodes", "2"),
        *("--env-kwargs", "max_episode_steps=10", "--n-envs", "2"),
    ],
    "benchmark compare": [],
    "experiments run": [],
    "experiments estimate": ["--steps", "20"],
    "experiments search": ["--trials", "1"],
    "experiments status": [],
    "experiments resume": [],
    "model train": ["--samples", "400", "--set", "epochs=1"],
    "run": ["--trials", "1"],
    "view": ["--episodes", "1", "--port", "0", "--env-kwargs", "max_episode_steps=5"],
}


def shortened(words: list[str]) -> list[str]:
    """Return the words of a command with those on top that make it take seconds."""
    if "--resume" in words:
        # The run that came before is finished: going on with it does nothing more.
        return [*words, "--no-progress"]
    command = " ".join(words[:2])
    more = SHORTER[command if command in SHORTER else words[0]]
    if "DualJacoPush-v0" in words and words[0] == "train" and "--advice" not in words:
        more = [*more, "net_arch=[256,256,256]"]  # it starts as two teachers: as wide as they
    return [*words, *more]


if __name__ == "__main__":
    from saver_advisors.cli import main

    sys.exit(main(shortened(sys.argv[1:])))
