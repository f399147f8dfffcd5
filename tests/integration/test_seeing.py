"""The loop with a camera over a person: seeing, every fault, recovery, what harm is done.

The pose network is stood in for by the true joints where its own work is not what is tested.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from reproduction.wrist_push.faults import FAULTS, with_fault
from reproduction.wrist_push.injections import ALLOWED, DURATION, inject
from saver_advisors.integration import perception_stages
from saver_advisors.integration.assembly import LoopSettings, build_loop, settings_for
from saver_advisors.integration.messages import Message, Person
from saver_advisors.integration.perception_stages import Estimator, PictureCheckStage, PoseStage
from saver_advisors.integration.stage import LoopStage
from saver_advisors.integration.wrist_bench import WristBench
from saver_envs.cameras.rgbd import BENCH_POSE, KINECT_V2, RgbdCamera
from saver_envs.people.bench import CAMERA, person_addresses
from saver_envs.perception.parsing import Poses


@pytest.fixture(scope="module")
def bench() -> Iterator[WristBench]:
    bench = WristBench()
    yield bench
    bench.close()


@pytest.fixture
def true_joints(bench: WristBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Find the joints that matter where they are, in pictures that show anything at all."""
    person = person_addresses(bench.episodes.scene)

    def look(rgb: np.ndarray) -> Poses:
        truth = bench.truth()
        joints, scores = np.full((1, 14, 2), np.nan), np.zeros((1, 14))
        if rgb.std() < 5:  # an even grey
            return Poses(joints[:0], scores[:0], np.zeros(0))
        elbows = bench.episodes.simulation.site_position[0, person.elbow_site]
        every = (((4, 7), truth.wrists), ((3, 6), elbows), ((8, 11), truth.hips))
        for places, points in every:
            joints[0, list(places)] = KINECT_V2.project(points, BENCH_POSE)[0]
            scores[0, list(places)] = 0.9
        return Poses(joints, scores, np.ones(1))

    def shipped() -> Estimator:
        return look

    monkeypatch.setattr(perception_stages, "shipped_estimator", shipped)


def settings() -> LoopSettings:
    return replace(settings_for("expert"), learned_kinematics=False)


def test_one_drawing_gives_what_two_give(bench: WristBench) -> None:
    bench.reset(3)
    rgb, _ = bench.picture()
    camera = bench._camera
    _, depth = camera.rgbd()
    slow = RgbdCamera(camera.model, CAMERA)
    slow.options.sitegroup[0] = 0  # as the loop's camera, which must not see the targets' marks
    slow_rgb, slow_depth = slow.capture(camera.data, None, shadows=False)
    slow.close()
    np.testing.assert_allclose(depth, slow_depth, atol=1e-5)
    assert (rgb != slow_rgb).any(axis=-1).mean() < 0.01


@pytest.mark.usefixtures("true_joints")
def test_what_is_seen_is_what_is_true(bench: WristBench) -> None:
    loop = build_loop(settings(), bench)
    seen: list[Person] = []

    def keep(topic: str, message: Message, now: float) -> None:
        if isinstance(message, Person):
            seen.append(message)

    loop.graph.observers.append(keep)
    bench.reset(1)
    loop.graph.reset()
    loop.graph.run_until(0.4, bench.advance_to)
    truth = bench.truth()
    assert len(seen) >= 9
    assert [one.stamp.sequence for one in seen] == list(range(1, len(seen) + 1))
    np.testing.assert_allclose(seen[-1].wrists, truth.wrists, atol=0.03)
    np.testing.assert_allclose(seen[-1].hips[:, :2], truth.hips[:, :2], atol=0.03)
    np.testing.assert_allclose(seen[-1].targets, truth.targets, atol=0.04)


@pytest.mark.slow
@pytest.mark.usefixtures("true_joints")
@pytest.mark.parametrize("fault", list(FAULTS))
def test_every_fault_stops_the_arms_and_is_got_over(bench: WristBench, fault: str) -> None:
    found = inject(settings(), bench, fault, seed=2)
    assert found["speed"] > 0.05, "the arms must move for it to mean anything"
    assert found["still_after"] is not None
    assert found["still_after"] <= ALLOWED
    assert found["named_rightly"], found["named"]
    # A stage that starts again takes longer than a frame.
    assert found["recovered_after"] is not None
    assert found["recovered_after"] < 0.4
    assert found["torso_force"] <= 50
    assert found["torso_displacement"] <= 0.02


@pytest.mark.usefixtures("true_joints")
def test_without_a_fault_the_arms_are_free(bench: WristBench) -> None:
    never = with_fault(FAULTS["frames lost"], [(90.0, 91.0)])
    loop = build_loop(settings(), bench, never)
    bench.reset(2)
    loop.graph.reset()
    loop.graph.run_until(0.3 + DURATION, bench.advance_to)
    assert [event for event in loop.health.log if event.kind == "stopped"] == []


@pytest.mark.slow
def test_the_network_sees_a_person_and_nobody(bench: WristBench) -> None:
    bench.reset(5)
    estimator = perception_stages.shipped_estimator()
    rgb, _ = bench.picture()
    people = estimator(rgb)
    truth = bench.truth()
    pixels, _ = KINECT_V2.project(truth.wrists, BENCH_POSE)
    np.testing.assert_allclose(people.joints[0, [4, 7]], pixels, atol=20)
    assert len(estimator(np.full_like(rgb, 120))) == 0


def test_a_fault_needs_its_stage() -> None:
    check: Callable[[list[LoopStage]], list[LoopStage]] = with_fault(FAULTS["frames lost"], [])
    with pytest.raises(ValueError, match="this loop has no stage 'camera'"):
        check([PictureCheckStage(), PoseStage(lambda rgb: Poses.none())])
