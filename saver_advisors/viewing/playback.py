"""Play episodes one action at a time, under the commands of whoever watches."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, Protocol

import numpy as np

from saver_advisors.datasets.recorded_episodes import EpisodeTape, RecordedEpisode
from saver_advisors.evaluation.episodes import (
    GOALS,
    EpisodeStep,
    Observation,
    Predict,
    SingleEpisodeEnv,
    play,
)
from saver_advisors.viewing.operator import KEYS, Operator
from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.simulation import ACTION_DURATION

HOLD: Final = 20
"""Number of ticks for which the end of an episode is shown."""
PUSH_ACTIONS: Final = 5
"""Duration of a push, 0.2 s."""


class Playback:
    """Plays the episodes of seed, seed + 1, ... of an environment.

    Other threads pass commands to :meth:`later`; all else belongs to the thread that plays.

    :param env_id: a registered id
    :param env_kwargs: keyword arguments of the environment
    :param policies: from a name to the policy, by which the viewer switches
    :param names: of the policies, the first of which plays
    :param seed: of the first episode
    :param arm: that an operator moves by hand; none if None
    :raises ValueError: for an arm that there is not
    """

    def __init__(
        self,
        env_id: str,
        env_kwargs: Mapping[str, Any],
        policies: Callable[[str], Predict],
        names: Sequence[str],
        *,
        seed: int = 0,
        arm: int | None = None,
    ) -> None:
        self.env_id, self.names = env_id, tuple(names)
        options: Any = dict(env_kwargs)
        self._env = SingleEpisodeEnv(SaverGoalEnv(env_id, **options))
        #: The episode that is played.
        self.episodes = self._env.env.episodes
        self._policies = policies
        self.choose(self.names[0])
        self._commands: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self.paused = False
        #: Whether time stands still while an operator commands nothing.
        self.waits = True
        self.played = self.successes = 0
        #: Number of recorded episodes, where they are recorded.
        self.demonstrations: int | None = None
        self._random = np.random.default_rng()
        #: Moves an arm by hand, if one is.
        self.operator: Operator | None = None
        self.start(seed)
        if arm is not None:
            self.operator = Operator(self.episodes, arm)

    @property
    def observation(self) -> Observation:
        """What the policy sees now, entries (1, size)."""
        return self._step.observation

    def later(self, command: Callable[[], object]) -> None:
        """Run a command before the next tick, in the thread that plays."""
        self._commands.put(command)

    def choose(self, name: str) -> None:
        """Let another policy play, from the next action on."""
        self._predict = self._policies(name)
        self.policy = name

    def start(self, seed: int) -> None:
        """Start the episode of a seed; one that has not ended is discarded."""
        self.seed = seed
        self._single = False
        self._push_left = 0
        #: Whether it was disturbed, so that its seed and actions do not repeat it.
        self.disturbed = False
        #: Whether the episode has ended.
        self.over = False
        self._steps = play(self._act, self._env, [seed])
        self._tape = EpisodeTape(seed)
        self._step: EpisodeStep = next(self._steps)
        self._tape.begin(self._step, 0, self._env.reset_infos[0])
        if self.operator is not None:
            self.operator.begin()

    def press(self, key: str) -> None:
        """Obey a key: one of the operator's, or one that rules time."""
        operator = self.operator
        if key == "space":
            self.paused = not self.paused
        elif key == "home":
            self.start(self.seed)
        elif key == "end":
            self.start(self.seed + 1)
        elif operator is None:
            return
        elif key in ("insert", "delete"):
            operator.grip(is_open=key == "insert")
        elif key == "enter":
            operator.finishing = True
        elif key in KEYS:
            operator.press(key)

    def single_step(self) -> None:
        """Pause, and play one action."""
        self.paused = self._single = True

    def bodies(self) -> dict[str, int]:
        """Return what can be pushed: names and indices of objects, other movable things, hands."""
        scene = self.episodes.scene
        model = scene.model
        moves = np.flatnonzero(model.body_jntnum)
        names = {model.body(index).name: int(index) for index in moves}
        loose = {name: index for name, index in names.items() if not name.startswith("arm")}
        hands = model.site_bodyid[scene.tool_site].tolist()
        return loose | {f"hand {arm}": index for arm, index in enumerate(hands)}

    def push(self, body: str, newtons: float) -> None:
        """Push something in a random level direction for 0.2 s; the episode is no demonstration.

        :param body: one of :meth:`bodies`
        :param newtons: force
        """
        if self.over:
            return
        angle = self._random.uniform(-np.pi, np.pi)
        force = newtons * np.array([np.cos(angle), np.sin(angle), 0.0])
        self.episodes.simulation.applied_force[0, self.bodies()[body], :3] = force
        self._push_left = PUSH_ACTIONS
        self.disturbed = True

    def tick(self) -> RecordedEpisode | None:
        """Obey the commands, and play an action unless time stands still.

        :return: the episode, if it ends with this action
        """
        while not self._commands.empty():
            self._commands.get()()
        if self.over:
            self._left -= not self.paused
            if self._left <= 0:
                self.start(self.seed + 1)
            return None
        idle = self.operator is not None and self.waits and not self.operator.acts
        if (self.paused or idle) and not self._single:
            return None
        self._single = False
        return self._advance()

    def _advance(self) -> RecordedEpisode | None:
        self._step = next(self._steps)
        self._tape.add(self._step, 0, self._actions, {})
        self._push_left -= 1
        if self._push_left <= 0:
            self.episodes.simulation.applied_force[:] = 0.0
        self.over = bool(self._step.dones[0])
        if not self.over:
            return None
        self._left = HOLD
        episode = self._tape.episode()
        self.played += 1
        self.successes += episode.success
        return episode

    def _act(self, observation: Observation) -> Any:
        actions = np.clip(np.asarray(self._predict(observation), np.float32), -1.0, 1.0)
        if self.operator is not None:
            actions = self.operator.replace(actions)
        self._actions = actions
        return actions

    def status(self) -> dict[str, str]:
        """Return what there is to say about the episode, by heading."""
        info, task = self._step.infos[0] or self._env.reset_infos[0], self.episodes.task
        goals = (np.asarray(self._step.observation[key][0], np.float64) for key in GOALS)
        centimetres = 100 * np.atleast_1d(task.distances(*goals))
        costs = {name: self._tape.total(name) for name in info if name.startswith("cost")}
        over = f", over ({'success' if info['is_success'] else 'failed'})" if self.over else ""
        lines = {
            "Episode": f"seed {self.seed}, action {self._step.number} of "
            f"{self.episodes.settings.horizon}{over}",
            "To the goal": ", ".join(f"{one:.1f} cm" for one in centimetres),
            "Success": "yes" if info["is_success"] else "no",
            "Costs so far": ", ".join(f"{name} {total:.3g}" for name, total in costs.items()),
            "Played": f"{self.played}, {self.successes} with success",
        }
        if self.demonstrations is not None:
            lines["Recorded"] = str(self.demonstrations)
        if self.disturbed:
            lines["Pushed"] = "this episode is not recorded"
        return lines

    def close(self) -> None:
        """Free what the environment holds."""
        self._env.env.close()


class View(Protocol):
    """Shows a playback, and passes commands to it."""

    def show(self) -> bool:
        """Show the present state; return whether it is still being watched."""

    def close(self) -> None:
        """Stop showing."""


def watch(
    playback: Playback, view: View, stopped: Callable[[], bool], speed: float = 1.0
) -> Iterator[RecordedEpisode]:
    """Play in real time until nobody watches, and yield episodes as they end.

    :param playback: what is played
    :param view: what shows it
    :param stopped: whether to stop
    :param speed: 1 for 25 actions per second
    """
    due = time.perf_counter()
    while view.show() and not stopped():
        episode = playback.tick()
        if episode is not None:
            yield episode
        now = time.perf_counter()
        due = max(due + ACTION_DURATION / speed, now)  # late: no faster afterwards
        time.sleep(due - now)
