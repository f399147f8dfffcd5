"""A video of an extraction, and a web page about a batch of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.integration.extraction import Extraction, greatest_forces, task_rows
from saver_advisors.reporting import video
from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.episodes import Episodes
from saver_envs.people.contact_forces import FORCE_LIMITS, PersonLoads
from saver_envs.simulation import ACTION_DURATION

Frame = NDArray[np.uint8]
#: Sizes (pixels) of the scene and of the forces on its right.
SCENE_SIZE: Final = (720, 540)
PANEL_WIDTH: Final = 300
#: Height of a part's row in the panel, and lengths of its name and of a bar at its limit (pixels).
_ROW, _NAME, _FULL = 38, 92, 130
_INK: Final = (40, 44, 52)


class ExtractionVideo:
    """Record an extraction as H.264: the scene, and forces by part of the body.

    :param path: of the file, ending in ``.mp4``.
    :param every: actions per frame, which speeds the video up.
    """

    def __init__(self, path: Path, every: int = 2) -> None:
        self._every = every
        size = SCENE_SIZE[0] + PANEL_WIDTH, SCENE_SIZE[1] + video.BAR_HEIGHT
        self._writer = video.mp4_writer(path, *size)
        self._scene: SceneRenderer | None = None
        self._episodes: Episodes | None = None
        self._greatest = dict.fromkeys(FORCE_LIMITS, 0.0)
        self._last: Frame | None = None

    def __call__(self, env_id: str, episodes: Episodes) -> None:
        """Record the first of the episodes; the argument ``look`` of :func:`extraction.extract`."""
        if episodes is not self._episodes:
            self._close_scene()
            self._episodes = episodes
            self._scene = SceneRenderer(episodes.scene, *SCENE_SIZE)
            self._greatest = dict.fromkeys(FORCE_LIMITS, 0.0)
        forces = self._forces(episodes)
        self._greatest = {part: max(forces[part], most) for part, most in self._greatest.items()}
        step = int(episodes.elapsed[0])
        if step % self._every:
            return
        assert self._scene is not None
        self._scene.update(episodes, 0)
        frame = np.concatenate([self._scene.rgb(), panel(forces, self._greatest)], axis=1)
        words = f"{env_id}   {step * ACTION_DURATION:5.2f} s"
        self._last = video.captioned(frame, words, video.GREY)
        self._writer.send(self._last)

    @staticmethod
    def _forces(episodes: Episodes) -> dict[str, float]:
        readings = episodes.simulation.keep(PersonLoads).readings(episodes.memory)
        return {part: float(readings[f"force_{part}"][0]) for part in FORCE_LIMITS}

    def end(self, extraction: Extraction) -> None:
        """Show the outcome for a while."""
        if self._last is not None:
            colour = video.GREEN if extraction.completed else video.RED
            words = f"{extraction.person}: {extraction.outcome}"
            last = video.captioned(self._last[: -video.BAR_HEIGHT], words, colour)
            for _ in range(2 * video.HOLD):
                self._writer.send(last)

    def _close_scene(self) -> None:
        if self._scene is not None:
            self._scene.close()

    def close(self) -> None:
        """Finish the file, and free the graphics context."""
        self._writer.close()
        self._close_scene()


def panel(forces: Mapping[str, float], greatest: Mapping[str, float]) -> Frame:
    """Draw forces by part of the body against their limits.

    :param forces: part -> N now.
    :param greatest: part -> the greatest so far, which is marked.
    :return: (height, width, 3).
    """
    from PIL import Image, ImageDraw

    picture = Image.new("RGB", (PANEL_WIDTH, SCENE_SIZE[1]), (250, 250, 250))
    draw = ImageDraw.Draw(picture)
    draw.text((12, 14), "force and its limit (N)", fill=_INK, font=video.font(13))
    for row, (part, limit) in enumerate(FORCE_LIMITS.items()):
        top = 52 + row * _ROW
        scale, left = _FULL / limit, 12 + _NAME
        longest = PANEL_WIDTH - left - 8
        width, mark = (min(one[part] * scale, longest) for one in (forces, greatest))
        colour = video.RED if forces[part] > limit else video.GREEN
        draw.text((12, top), part.replace("_", " "), fill=_INK, font=video.font(13))
        draw.rectangle((left, top + 2, left + _FULL, top + 16), fill=(226, 229, 233))
        draw.rectangle((left, top + 2, left + width, top + 16), fill=colour)
        draw.line((left + mark, top, left + mark, top + 18), fill=_INK, width=2)
        text = f"{forces[part]:.0f} of {limit:.0f}"
        draw.text((left, top + 18), text, fill=(91, 102, 114), font=video.font(11))
    return np.asarray(picture)


def write_report(
    folder: Path,
    extractions: Sequence[Extraction],
    policies: Mapping[str, str],
    seeing: bool,
    video_name: str,
) -> Path:
    """Write a page about extractions.

    :param folder: created if missing.
    :param extractions: at least one.
    :param policies: id -> the policy that played it, in the order of the procedure.
    :param seeing: whether a camera found the person.
    :param video_name: of a video of the first one, in the same folder.
    :return: path of the page.
    """
    from saver_advisors.reporting.provenance import provenance
    from saver_advisors.reporting.templates import rendered

    folder.mkdir(parents=True, exist_ok=True)
    rows = task_rows(extractions, policies)
    page = rendered(
        "saver_advisors.integration",
        "extraction.html.j2",
        extractions=extractions,
        completed=sum(one.completed for one in extractions),
        ids=list(policies),
        tasks=rows,
        columns=list(rows[0]),
        forces=[
            greatest_forces([one.steps[number] for one in extractions if number < len(one.steps)])
            for number in range(len(rows))
        ],
        seeing=seeing,
        limits=FORCE_LIMITS,
        video=video_name,
        provenance=provenance(),
    )
    path = folder / "index.html"
    path.write_text(page, encoding="utf-8")
    return path
