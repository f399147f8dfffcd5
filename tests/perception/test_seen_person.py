"""What arms observe where a camera has to find the person."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from rollouts import begun

from saver_envs.episodes import Episodes
from saver_envs.perception.skeleton import JOINTS
from saver_envs.registration import EXTRACTION_IDS
from saver_envs.wrappers import seen_person
from saver_envs.wrappers.seen_person import SeenPeople, SeenPersonObservation

ARMS = "ArmStraighten-v0"
WRIST = JOINTS.index("right_wrist")


class TrueEye:
    """Sees every joint where it is, but for what a test changes.

    :param episodes: that are seen.
    """

    def __init__(self, episodes: Episodes, *_: Any, **options: Any) -> None:
        self.options = options
        self.times = np.zeros(episodes.n)
        self.shift = np.zeros((len(JOINTS), 3))
        self.scores = np.ones(len(JOINTS))
        self._episodes = episodes
        model = episodes.scene.model
        self._sites = [model.site(f"joint_{name}").id for name in JOINTS]

    def begin(self, row: int, seed: int | None) -> None:
        self.times[row] = 0.0

    def entries(self, row: int) -> dict[str, Any]:
        places = self._episodes.simulation.site_position[row, self._sites] + self.shift
        return {"pose_3d": places, "pose_scores_3d": self.scores}

    def close(self) -> None:
        pass


@pytest.fixture(autouse=True)
def eye(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seen_person, "PoseCamera", TrueEye)


def seeing(env_id: str, n: int = 1) -> tuple[Episodes, SeenPeople, Any]:
    """Return episodes, what sees them, and its camera."""
    episodes = begun(env_id, n)
    people = SeenPeople(episodes)
    people.begin()
    return episodes, people, people._camera


@pytest.mark.parametrize("env_id", EXTRACTION_IDS)
def test_joints_that_are_seen_where_they_are_change_nothing(env_id: str) -> None:
    episodes, people, _ = seeing(env_id, 2)
    task: Any = episodes.task
    seen, true = people.observed(), episodes.observation().as_dict()
    assert people.ready.all()
    layout = task.observation_layout
    for part in layout.parts:
        # Hinges are not quite in the centres of the joints.
        tolerance = 0.15 if part.name.endswith("bend") else 1e-5
        ours, wanted = (layout.get(one["observation"], part.name) for one in (seen, true))
        np.testing.assert_allclose(ours, wanted, atol=tolerance, err_msg=part.name)
    np.testing.assert_allclose(seen["desired_goal"], true["desired_goal"], atol=0.02)
    np.testing.assert_allclose(seen["achieved_goal"], true["achieved_goal"], atol=0.15)


def wrist_of(episodes: Episodes, seen: dict[str, Any]) -> Any:
    """Return where the right wrist is, which arm 0 handles."""
    return episodes.task.observation_layout.get(seen["observation"], "object position")[0, 0]


def test_a_hidden_joint_keeps_its_place_and_a_jump_has_to_be_seen_again() -> None:
    episodes, people, camera = seeing(ARMS)
    first = wrist_of(episodes, people.observed())
    camera.shift[WRIST] = (0.0, 0.0, 0.05)
    camera.scores[WRIST] = 0.1
    np.testing.assert_array_equal(wrist_of(episodes, people.observed()), first)
    camera.scores[WRIST] = 1.0
    nearer = wrist_of(episodes, people.observed())
    assert first[2] < nearer[2] < first[2] + 0.05
    camera.shift[WRIST] = (0.0, 0.0, 0.5)
    for _ in range(2):
        np.testing.assert_array_equal(wrist_of(episodes, people.observed()), nearer)
    for _ in range(12):
        last = wrist_of(episodes, people.observed())
    assert last[2] == pytest.approx(first[2] + 0.5, abs=0.01)


def test_the_relative_position_and_the_goal_follow_what_is_seen() -> None:
    episodes, people, camera = seeing(ARMS)
    camera.shift[:] = (0.03, -0.02, 0.01)
    seen, true = people.observed(), episodes.observation().as_dict()
    layout = episodes.task.observation_layout
    for part in ("object position", "object position relative to the gripper"):
        change = layout.get(seen["observation"], part) - layout.get(true["observation"], part)
        np.testing.assert_allclose(change, np.tile(camera.shift[0], (1, 2, 1)), atol=1e-5)
    change = (seen["desired_goal"] - true["desired_goal"]).reshape(2, 4)
    np.testing.assert_allclose(change[:, :2], np.tile([0.03, -0.02], (2, 1)), atol=0.02)


def test_until_a_joint_is_seen_the_person_is_not() -> None:
    env = SeenPersonObservation(gymnasium.make(ARMS))
    camera: Any = env._people._camera
    camera.scores[WRIST] = 0.0
    observation, info = env.reset(seed=0)
    assert not info["person_seen"]
    assert env.observation_space.contains(observation)
    camera.scores[WRIST] = 1.0
    _, _, _, _, info = env.step(env.action_space.sample())
    assert info["person_seen"] and camera.times[0] > 0
    env.close()


def test_a_task_without_joints_is_refused() -> None:
    with pytest.raises(TypeError, match="'push': has no joint_parts"):
        SeenPersonObservation(gymnasium.make("JacoPush-v0"))


@pytest.mark.parametrize(("env_id", "turn"), [(ARMS, 0), ("Intake-v0", 2)])
def test_pictures_are_turned_so_that_the_head_is_up(env_id: str, turn: int) -> None:
    assert seeing(env_id)[2].options["turn"] == turn
