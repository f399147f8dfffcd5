"""The style of curves: colours, markers, axes."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from saver_advisors.evaluation.metrics import SOLVED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The palette of Okabe and Ito, which is safe for colour-blind readers.
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
GREY: Final = "0.55"


class Pen(NamedTuple):
    """The colour and dashes of a curve.

    :param colour: Matplotlib's
    :param dashes: Matplotlib's line style
    """

    colour: str
    dashes: str = "-"


# All colours solid, then all dashed, then all dotted.
PENS: Final = tuple(Pen(colour, dashes) for dashes, colour in product(("-", "--", ":"), COLOURS))

FEW_POINTS: Final = 40
"""Most evaluations of a curve that is drawn with markers."""


def line_style(points: int) -> dict[str, Any]:
    """Return the line style of a curve, with markers if it has few points.

    :param points: number of points
    :return: arguments of Matplotlib's ``plot``
    """
    few = points <= FEW_POINTS
    return {"linewidth": 1.6, "marker": "o" if few else None, "markersize": 3.5}


def dress(axes: Axes, name: str) -> None:
    """Apply the common grid, spines and limits.

    :param axes: whose horizontal axis starts from 0
    :param name: column of the curve that is shown
    """
    axes.grid(color="0.9", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlim(left=0)
    if name == "success_rate":
        axes.set_ylim(-0.02, 1.02)
        axes.axhline(SOLVED, color="0.6", linewidth=0.8, linestyle=":")
    elif name.endswith("_rate"):
        axes.set_ylim(-0.02, 1.02)
    elif name.startswith("cost"):
        axes.set_ylim(bottom=0)
