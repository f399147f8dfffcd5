"""The text that the pages of tasks with cubes share."""

from __future__ import annotations

from saver_envs.tasks.contract import Task, TaskPage
from saver_envs.tasks.cubes import Cubes
from saver_envs.tasks.regions import Regions
from saver_envs.tasks.sampling import (
    CLEARANCE_WIDTHS,
    HAND_CLEARANCE,
    HAND_TO_OBJECT,
    HAND_TO_OTHER_OBJECT,
    OBJECT_TO_TARGET,
    StartRules,
)


def table_page(task: Task, cubes: Cubes, rules: StartRules, boxes: Regions) -> TaskPage:
    """Return the page of a task with cubes.

    :param task: the task.
    :param cubes: its cubes.
    :param rules: of its starts.
    :param boxes: of hands, cubes and targets.
    """
    centimetres = f"{100 * task.success_threshold:g} cm"
    subject = "the cube is" if task.n_arms == 1 else "every cube is"
    where = " on the table" if task.held_height is not None else ", on the table or in the air"
    facts = f"{100 * cubes.size:g} cm, {cubes.mass:g} kg, friction {cubes.friction:g}"
    return TaskPage(
        thing="cube",
        succeeds=f"{subject} within {centimetres} of its target{where}",
        start=_start(task, rules, boxes),
        reward="0 where every cube is within the threshold of its target, else -1.",
        dense="minus the sum of the cubes' distances to their targets, in metres.",
        costs={
            "collision": (
                "1 on a step with contact between arms, or of an arm with the table or with "
                "another arm's cube"
            )
        },
        goal={"object position": "centre of the cube (achieved), its target (desired)"},
        facts=(("cubes", facts),),
    )


def _start(task: Task, rules: StartRules, boxes: Regions) -> list[str]:
    """What the sampler guarantees, each with its figure."""
    lines = [
        f"A cube {_span(HAND_TO_OBJECT)} from its hand, its target {_span(OBJECT_TO_TARGET)} from "
        "the cube.",
        *_boxes(boxes),
        _hands(rules),
        _targets(rules),
    ]
    if rules.pushes:
        lines.append("Behind each cube there is room for the hand that is to push it.")
    if task.n_arms > 1:
        lines += _several_arms(rules)
    lines.append("Hands, cubes and targets can be reached: the sampler looks each of them up.")
    return lines


def _boxes(boxes: Regions) -> list[str]:
    """Describe each arm's box; one line for all where they are alike."""
    texts = [
        f"x {lower[0]:g} to {upper[0]:g} m, y {lower[1]:g} to {upper[1]:g} m"
        for lower, upper in zip(boxes.object_lower, boxes.object_upper, strict=True)
    ]
    reach = f"at most {boxes.reach:g} m from the base"
    if len(set(texts)) == 1:
        return [f"Cubes and targets in {texts[0]}, {reach}."]
    return [f"Arm {arm}: cube and target in {box}, {reach}." for arm, box in enumerate(texts)]


def _hands(rules: StartRules) -> str:
    low, high = rules.hand_height
    if low == high:
        return f"Hands closed, {100 * low:g} cm above the table."
    return f"Hands open, {100 * low:g} to {100 * high:g} cm above the table."


def _targets(rules: StartRules) -> str:
    if rules.air_share == 0:
        return "Targets on the table."
    return (
        f"{rules.air_share:.0%} of the targets in the air, up to {100 * rules.air_height:g} cm; "
        "the others on the table."
    )


def _several_arms(rules: StartRules) -> list[str]:
    lines = [
        f"Cubes and targets of different arms are at least {CLEARANCE_WIDTHS:g} cube widths apart, "
        f"hands {100 * HAND_CLEARANCE:g} cm from one another and "
        f"{100 * HAND_TO_OTHER_OBJECT:g} cm from other arms' cubes."
    ]
    if rules.separation is not None:
        low, high = rules.separation
        lines.append(f"Both cubes, and both targets, {low:g} to {high:g} m apart.")
    elif rules.contested_share > 0:
        lines.append(
            f"In {rules.contested_share:.0%} of the episodes the ways of two neighbours' cubes "
            "cross, so that the arms must give way; in the others hardly ever. The share holds for "
            "2, 3 and 4 arms."
        )
    return lines


def _span(span: tuple[float, float]) -> str:
    return f"{100 * span[0]:g} to {100 * span[1]:g} cm"
