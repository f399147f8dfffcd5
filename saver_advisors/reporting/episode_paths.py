"""Plot one episode in space and time, like the dissertation's Figure 6.3.

The left panel shows the distance between the objects over time, with the band that a constraint
allows; the right panel shows the paths of hands and objects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.evaluation.episodes import Predict, SingleEpisodeEnv, play
from saver_advisors.reporting.curve_style import COLOURS, GREY, dress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CENTIMETRES: Final = 100.0

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EpisodePaths:
    """The positions during an episode, in the world frame, metres.

    :param title: of the episode in the figure
    :param seconds: (steps + 1,) time of each state, from 0
    :param hands: (steps + 1, arms, 3)
    :param objects: (steps + 1, arms, 3)
    :param targets: (arms, 3)
    :param success: whether it succeeded
    :param band: least and largest allowed distance between the objects, None without a constraint
    """

    title: str
    seconds: Floats
    hands: Floats
    objects: Floats
    targets: Floats
    success: bool
    band: tuple[float, float] | None = None

    @property
    def distances(self) -> Floats:
        """Distances (steps + 1,) between the first two objects, metres.

        :raises ValueError: for an episode of one arm
        """
        if self.objects.shape[1] < 2:
            raise ValueError(f"{self.title}: an episode of one arm has no distance between objects")
        return np.linalg.norm(self.objects[:, 0] - self.objects[:, 1], axis=-1)


def follow(
    predict: Predict,
    env_id: str,
    *,
    title: str,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
) -> EpisodePaths:
    """Play and record one episode, the same as in an evaluation with that seed.

    :param predict: batched Dict observation (1, size) -> actions (1, action_size)
    :param env_id: a registered id
    :param title: of the episode in the figure
    :param seed: of the episode
    :param env_kwargs: keyword arguments of the environment
    :return: its paths
    """
    from saver_envs.envs.goal_env import SaverGoalEnv
    from saver_envs.simulation import ACTION_DURATION

    with closing(SaverGoalEnv(env_id, **(env_kwargs or {}))) as env:
        episodes = env.episodes
        task, simulation, to_world = episodes.task, episodes.simulation, episodes.scene.to_world
        hands, objects = [], []
        for step in play(predict, SingleEpisodeEnv(env), [seed]):
            info = step.infos[0]
            arms = simulation.arm_state()
            seen = task.observe(simulation, episodes.memory, arms)
            hands.append(to_world(arms.tool_position)[0])
            objects.append(to_world(seen["object position"])[0])
        band = None
        if task.constraint is not None:
            name, tolerance = task.constraint
            required = float(task.goal_layout.get(episodes.goal, name)[0, 0])
            band = (required - tolerance, required + tolerance)
        return EpisodePaths(
            title=title,
            seconds=ACTION_DURATION * np.arange(len(hands), dtype=np.float64),
            hands=np.stack(hands),
            objects=np.stack(objects),
            targets=episodes.targets()[0],
            success=bool(info["is_success"]),
            band=band,
        )


def draw_paths(episodes: Sequence[EpisodePaths]) -> Figure:
    """Plot episodes one below the other.

    :param episodes: of two arms or more
    :return: the figure
    :raises ValueError: for an episode of one arm
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2 * len(episodes)), layout="constrained", dpi=110)
    rows = figure.subfigures(len(episodes), 1, squeeze=False)[:, 0]
    for row, episode in zip(rows, episodes, strict=True):
        row.suptitle(f"{episode.title}: {'success' if episode.success else 'no success'}")
        left, right = row.subfigures(1, 2)
        _draw_distance(left.subplots(), episode)
        _draw_ways(right.add_subplot(projection="3d"), episode)
    return figure


def _draw_distance(axes: Any, episode: EpisodePaths) -> None:
    distances = CENTIMETRES * episode.distances
    if episode.band is not None:
        low, high = (CENTIMETRES * edge for edge in episode.band)
        axes.axhspan(low, high, color=COLOURS[2], alpha=0.2, linewidth=0, label="allowed")
    axes.plot(episode.seconds, distances, color=COLOURS[0], linewidth=1.6, label="distance")
    axes.set_xlabel("time (s)")
    axes.set_ylabel("distance between the objects (cm)")
    dress(axes, "distance")
    axes.set_xlim(right=episode.seconds[-1])
    axes.margins(y=0.15)
    axes.legend(frameon=False)


def _draw_ways(axes: Any, episode: EpisodePaths) -> None:
    for arm in range(episode.objects.shape[1]):
        colour = COLOURS[arm % len(COLOURS)]
        for places, style, what in (
            (episode.hands, ":", "hand"),
            (episode.objects, "-", "object"),
        ):
            way = CENTIMETRES * places[:, arm].T
            axes.plot(*way, style, color=colour, linewidth=1.4, label=f"{what} {arm + 1}")
        start, target = (
            CENTIMETRES * point for point in (episode.objects[0, arm], episode.targets[arm])
        )
        axes.scatter(*start, color=colour, marker="s", s=30)
        axes.scatter(*target, color=colour, marker="*", s=110)
    if episode.objects.shape[1] == 2:
        for index in np.linspace(0, len(episode.objects) - 1, 6).astype(int):
            ends = CENTIMETRES * episode.objects[index].T
            axes.plot(*ends, color=GREY, linewidth=0.8)
    axes.set_xlabel("x (cm)")
    axes.set_ylabel("y (cm)")
    axes.set_zlabel("z (cm)")
    axes.set_aspect("equalxy")
    axes.set_box_aspect(None, zoom=0.85)
    axes.locator_params(axis="x", nbins=3)
    axes.legend(frameon=False, fontsize="small", loc="upper left")
