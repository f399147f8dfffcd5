"""The settings that a search varies, each with the values from which it is drawn."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.experiments.grid import is_whole

if TYPE_CHECKING:
    from optuna import Trial

VALID: Final = (
    "{uniform: [low, high]}, {log_uniform: [low, high]}, {int: [low, high]} or "
    "{choice: [value, ...]}"
)
#: Greatest number: whole numbers up to here are exact as floating-point numbers.
MOST: Final = 2**53
#: Settings that decide how a run is measured: with other values, trials are not comparable.
FIXED: Final = (
    *("env_id", "env_kwargs", "seed", "total_steps"),
    *("eval_every", "eval_episodes", "eval_seed"),
)


@dataclass(frozen=True)
class SearchedSetting:
    """A setting that differs between trials.

    :param name: of the setting; ``outer.inner`` is an entry of a nested one
    :param kind: ``uniform``, ``log_uniform``, ``int`` or ``choice``
    :param values: of a choice; otherwise the least and the greatest value
    :raises ValueError: for invalid values
    """

    name: str
    kind: str
    values: tuple[Any, ...]

    def __post_init__(self) -> None:
        if self.kind == "choice":
            texts = self._texts
            if not texts or len(set(texts)) < len(texts):
                raise ValueError(
                    f"choice={list(self.values)!r} must be one or more distinct values"
                )
            return
        text = next((one for one in self.values if isinstance(one, str)), None)
        if text is not None:
            raise ValueError(f"{self.kind}: {text!r} is text in YAML: write 1e-4 as 1.0e-4")
        whole = self.kind == "int"
        known = all(_is_number(one) and (is_whole(one, -MOST) or not whole) for one in self.values)
        if not known or len(self.values) != 2 or self.values[0] >= self.values[1]:
            numbers = "integers" if whole else "numbers"
            raise ValueError(
                f"{self.kind}={list(self.values)!r} must be two {numbers}, the lower one first"
            )
        if self.kind == "log_uniform" and self.values[0] <= 0:
            raise ValueError(f"log_uniform={list(self.values)!r} must be above 0")

    @property
    def _texts(self) -> list[str]:
        """The values of a choice as Optuna accepts them: lists are not allowed."""
        return [json.dumps(one) for one in self.values]

    def suggest(self, trial: Trial) -> Any:
        """Return the value of a trial, which is drawn at the first call.

        :param trial: of the study
        """
        if self.kind == "choice":
            return self.plain(trial.suggest_categorical(self.name, self._texts))
        if self.kind == "int":
            return trial.suggest_int(self.name, *self.values)
        return trial.suggest_float(self.name, *self.values, log=self.kind == "log_uniform")

    def plain(self, drawn: Any) -> Any:
        """Return the value for what the study has of a trial.

        :param drawn: the parameter of Optuna
        """
        return json.loads(drawn) if self.kind == "choice" else drawn


def parse_space(content: Any) -> tuple[SearchedSetting, ...]:
    """Read the settings of a search.

    :param content: name -> a distribution, see :data:`VALID`
    :return: one or more settings
    :raises ValueError: for anything else, naming the entry
    """
    if not isinstance(content, Mapping) or not content:
        raise ValueError(f"space={content!r} must be names of settings, each with {VALID}")
    return tuple(_parse_setting(str(name), value) for name, value in content.items())


def _parse_setting(name: str, value: Any) -> SearchedSetting:
    place = f"space.{name}"
    if name.partition(".")[0] in FIXED:
        raise ValueError(f"{place}: must be the same in all trials: {', '.join(FIXED)}")
    kind, values = next(iter(value.items())) if _is_entry(value) else ("", None)
    if kind not in ("uniform", "log_uniform", "int", "choice") or not isinstance(values, list):
        raise ValueError(f"{place}={value!r} must be {VALID}")
    try:
        return SearchedSetting(name, kind, tuple(values))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{place}: {error}") from error


def _is_entry(value: Any) -> bool:
    return isinstance(value, Mapping) and len(value) == 1


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MOST
