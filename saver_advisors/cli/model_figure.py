"""Plot a recording of an arm, like Figures 7.8 and 7.10 of the dissertation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from saver_envs.modelling.datasets import Recording

_QUANTITIES: Final = (
    ("position", "position (rad)"),
    ("velocity", "velocity (rad/s)"),
    ("acceleration", "acceleration (rad/s²)"),
    ("torque", "torque (N m)"),
)
_SHOWN: Final = 1200
"""Number of plotted samples; more would hide the curves' shapes."""


def draw_recording(recording: Recording, robot: str) -> Figure:
    """Plot the first samples of a recording, one column per joint.

    :param recording: the samples
    :param robot: the arm's name
    :return: the figure
    """
    from matplotlib.figure import Figure

    from saver_envs.modelling.arms import arm_named

    slides = arm_named(robot).chain.prismatic
    joints = len(slides)
    figure = Figure(figsize=(2.6 * joints, 8.0), layout="constrained")
    axes = figure.subplots(len(_QUANTITIES), joints, sharex=True, squeeze=False)
    for row, (name, label) in enumerate(_QUANTITIES):
        values = getattr(recording, name)[:_SHOWN]
        for joint in range(joints):
            axis = axes[row, joint]
            axis.plot(values[:, joint], linewidth=0.7, color=f"C{row}")
            axis.tick_params(labelsize=7)
            axis.grid(alpha=0.3)
            if row == 0:
                hinges = joint + 1 - sum(slides[: joint + 1])
                title = "lift (m, N)" if slides[joint] else f"joint {hinges}"
                axis.set_title(title, fontsize=9)
            if joint == 0:
                axis.set_ylabel(label, fontsize=9)
            if row == len(_QUANTITIES) - 1:
                axis.set_xlabel("sample", fontsize=8)
    return figure
