"""Strategies by the names that configurations use; a place to add your own."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from typing import Any, Final, TypeVar

from saver_advisors.advising.context import AdvisingStrategy
from saver_advisors.advising.ibrl import BetterOfBoth
from saver_advisors.advising.jump_start import JumpStart
from saver_advisors.advising.random_advising import RandomAdvising
from saver_advisors.advising.strategies import (
    CORRECTING,
    DEFAULT_THRESHOLD,
    EarlyAdvising,
    EarlyThenCorrecting,
    MistakeCorrectingAction,
    MistakeCorrectingQ,
    MistakeCorrectingRelativeAction,
    NoAdvice,
)

STRATEGIES: Final[dict[str, type[AdvisingStrategy]]] = {
    "none": NoAdvice,
    "early": EarlyAdvising,
    "mc-q": MistakeCorrectingQ,
    "mc-act": MistakeCorrectingAction,
    "mc-actabs": MistakeCorrectingRelativeAction,
    "early-mc": EarlyThenCorrecting,
    "random": RandomAdvising,
    "jump-start": JumpStart,
    "ibrl": BetterOfBoth,
}
"""Every strategy by the name that configurations use."""

Strategy = TypeVar("Strategy", bound=type[AdvisingStrategy])

_MEMBERS: Final = ("name", "needs_critics", "settings", "decide")


def register_strategy(strategy: Strategy) -> Strategy:
    """Make a strategy known by its name; a decorator.

    :param strategy: a class with the members of `AdvisingStrategy`
    :return: the same class
    :raises TypeError: where a member is missing
    :raises ValueError: where another strategy has that name
    """
    _require_class(strategy)
    known = STRATEGIES.get(strategy.name)
    if known is not None and known is not strategy:
        raise ValueError(
            f"name={strategy.name!r} of {strategy.__name__} belongs to {known.__name__} already: "
            "choose another"
        )
    STRATEGIES[strategy.name] = strategy
    return strategy


def make_strategy(
    name: str,
    threshold: float | None = None,
    *,
    correcting: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> AdvisingStrategy:
    """A strategy by name.

    :param name: a key of `STRATEGIES`, or "module:Class" for one that is not registered
    :param threshold: t_I (mc-q) or alpha (mc-act, mc-actabs), or that of early-mc's second half;
        0.1 by default
    :param correcting: early-mc's second half: mc-q (default), mc-act or mc-actabs
    :param settings: further arguments of the strategy's class, by name
    :raises ValueError: for an unknown name, a threshold out of range, or an argument that the
        strategy has not
    :raises TypeError: where "module:Class" is no strategy
    """
    strategy = _find(name)
    arguments = dict(settings or {})
    if correcting is not None and name != "early-mc":
        raise ValueError(f"correcting={correcting!r} belongs to 'early-mc' only, not to {name!r}")
    if name == "early-mc":
        second = "mc-q" if correcting is None else correcting
        if second not in CORRECTING:
            raise ValueError(
                f"correcting={second!r} is unknown: use one of {', '.join(CORRECTING)}"
            )
        limit = DEFAULT_THRESHOLD if threshold is None else threshold
        arguments["correcting"] = CORRECTING[second](limit)
    elif threshold is not None:
        if "threshold" not in inspect.signature(strategy).parameters:
            raise ValueError(
                f"strategy {name!r} takes no threshold, but threshold={threshold!r} was given"
            )
        arguments["threshold"] = threshold
    _require_known(name, strategy, settings or {})
    made = strategy(**arguments)
    _require_members(made, _MEMBERS)
    return made


def _find(name: str) -> type[AdvisingStrategy]:
    """The class that a name stands for."""
    if name in STRATEGIES:
        return STRATEGIES[name]
    module, _, attribute = name.partition(":")
    if not attribute:
        raise ValueError(
            f"strategy={name!r} is unknown: use one of {', '.join(STRATEGIES)}, or 'module:Class' "
            "for one of your own"
        )
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"strategy={name!r} cannot be imported: {error}") from error
    _require_class(found)
    strategy: type[AdvisingStrategy] = found
    return strategy


def _require_class(found: Any) -> None:
    """:raises TypeError: for anything but a class with a name and a decision"""
    if not isinstance(found, type):
        raise TypeError(f"{found!r} is no class: a strategy is one with {', '.join(_MEMBERS)}")
    # The others may be set by the constructor.
    _require_members(found, ("name", "decide"))


def _require_members(found: Any, members: tuple[str, ...]) -> None:
    missing = [member for member in members if not hasattr(found, member)]
    if missing:
        raise TypeError(
            f"{found!r} lacks {', '.join(missing)}: a strategy has {', '.join(_MEMBERS)} "
            "(see AdvisingStrategy)"
        )


def _require_known(
    name: str, strategy: type[AdvisingStrategy], settings: Mapping[str, Any]
) -> None:
    """Refuse settings that the strategy's constructor does not have."""
    parameters = inspect.signature(strategy).parameters
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters.values()):
        return
    unknown = sorted(set(settings) - set(parameters))
    if unknown:
        raise ValueError(
            f"strategy {name!r} has no setting {', '.join(unknown)}; it takes "
            f"{', '.join(parameters) or 'none'}"
        )
