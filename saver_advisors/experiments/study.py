"""The Optuna study of a search, in a file that several processes or machines share.

A trial that runs is locked by its process; the operating system releases the lock when the process
ends, however it does. A trial that runs according to the file, but is not locked, was interrupted:
the next process that asks for a trial continues it.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import optuna
from filelock import FileLock
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock
from optuna.trial import FrozenTrial, TrialState

from saver_advisors.experiments.search import JOURNAL_FILE, MAY_CHANGE, Search
from saver_advisors.training.run_folder import FolderInUseError, locked

LOCK_FOLDER: Final = "locks"
STUDY: Final = "search"
CONTENT: Final = "content"
"""Attribute of the study with the content of the search's file."""


@dataclass(frozen=True)
class ClaimedTrial:
    """A trial that this process works on.

    :param number: from 0
    :param values: drawn for it, by name of the setting
    :param optuna_trial: takes reports
    :param reported: steps of the evaluations that are reported already
    """

    number: int
    values: Mapping[str, Any]
    optuna_trial: optuna.Trial
    reported: set[int]

    @property
    def name(self) -> str:
        """Its name in tables, and the start of the names of its runs."""
        return trial_name(self.number)


class SharedStudy:
    """The trials of a search.

    :param folder: of the search, created if missing
    :param search: what is searched
    :raises ValueError: if the folder has another search, naming the entries that differ
    """

    def __init__(self, folder: Path, search: Search) -> None:
        self.search = search
        self._locks = folder / LOCK_FOLDER
        self._locks.mkdir(parents=True, exist_ok=True)
        # One process draws at a time, so that the number of trials is exact.
        self._drawing = FileLock(self._locks / "drawing")
        with self._drawing:
            self._study = optuna.create_study(
                storage=_storage(folder),
                study_name=STUDY,
                direction=search.objective.direction,
                pruner=_pruner(search),
                load_if_exists=True,
            )
            known = self._study.user_attrs.get(CONTENT)
            _check_same(known or search.content, search.content)
            if known != search.content:
                self._study.set_user_attr(CONTENT, dict(search.content))

    @property
    def trials(self) -> list[FrozenTrial]:
        """All trials in the order of their numbers."""
        return self._study.get_trials(deepcopy=False)

    @contextmanager
    def claimed(self, tried: Collection[int]) -> Iterator[ClaimedTrial | None]:
        """Claim an interrupted trial or draw a new one; None if there is no more to do.

        :param tried: numbers of trials that failed in this process, which are not tried again
        :return: a context that keeps other processes from the trial
        """
        with ExitStack() as stack:
            with self._drawing:
                trial = self._interrupted(stack, tried) or self._new(stack)
                # Suggestions are drawn while no other thread sets the sampler.
                values = {} if trial is None else self._values(trial)
            if trial is None:
                yield None
                return
            known = self.trials[trial.number].intermediate_values
            yield ClaimedTrial(trial.number, values, trial, set(known))

    def tell(self, trial: ClaimedTrial, value: float | None, state: TrialState) -> None:
        """Record how a trial ended.

        :param trial: claimed by this process
        :param value: of the objective, None for trials without one
        :param state: ``COMPLETE``, ``PRUNED`` or ``FAIL``
        """
        self._study.tell(trial.optuna_trial, value, state)

    def values_of(self, trial: FrozenTrial) -> dict[str, Any]:
        """Return the values that were drawn for a trial, by name of the setting."""
        drawn = [one for one in self.search.space if one.name in trial.params]
        return {one.name: one.plain(trial.params[one.name]) for one in drawn}

    def state_of(self, trial: FrozenTrial) -> str:
        """Describe the state of a trial: done, pruned, failed, running or interrupted."""
        if trial.state is not TrialState.RUNNING:
            words = {TrialState.COMPLETE: "done", TrialState.FAIL: "failed"}
            return words.get(trial.state, trial.state.name.lower())
        with ExitStack() as stack:
            return "interrupted" if self._locked(stack, trial.number) else "running"

    @property
    def best(self) -> FrozenTrial | None:
        """The best finished trial, None without any."""
        done = [trial for trial in self.trials if trial.state is TrialState.COMPLETE]
        return self._study.best_trial if done else None

    def _interrupted(self, stack: ExitStack, tried: Collection[int]) -> optuna.Trial | None:
        for trial in self._study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            if trial.number not in tried and self._locked(stack, trial.number):
                return optuna.Trial(self._study, trial._trial_id)
        return None

    def _new(self, stack: ExitStack) -> optuna.Trial | None:
        number = len(self.trials)
        if number >= self.search.trials:
            return None
        # Before the trial exists: no other process takes it for an interrupted one.
        if not self._locked(stack, number):
            raise FolderInUseError(f"{self._locks / trial_name(number)} is in use")
        # The seed depends on the trial only, so that no two processes draw the same.
        self._study.sampler = optuna.samplers.TPESampler(seed=number, constant_liar=True)
        return self._study.ask()

    def _values(self, trial: optuna.Trial) -> dict[str, Any]:
        return {setting.name: setting.suggest(trial) for setting in self.search.space}

    def _locked(self, stack: ExitStack, number: int) -> bool:
        """Lock a trial for the duration of a context; return whether that was possible."""
        try:
            stack.enter_context(locked(self._locks / trial_name(number)))
        except FolderInUseError:
            return False
        return True


def trial_name(number: int) -> str:
    """Return the name of a trial."""
    return f"trial-{number:04d}"


def open_study(folder: Path) -> SharedStudy:
    """Open the study of a search in its folder, with the file's content at the last session.

    :param folder: of the search
    :raises ValueError: for a file that holds no search
    """
    try:
        study = optuna.load_study(study_name=STUDY, storage=_storage(folder))
        return SharedStudy(folder, Search(study.user_attrs[CONTENT]))
    except (KeyError, json.JSONDecodeError) as error:
        raise ValueError(f"{folder / JOURNAL_FILE} holds no search: {error}") from error


def _storage(folder: Path) -> JournalStorage:
    # Absolute, since Optuna's lock is a symbolic link to the file.
    path = str((folder / JOURNAL_FILE).resolve())
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    backend = JournalFileBackend(path, JournalFileSymlinkLock(path))
    _mend(Path(path))
    return JournalStorage(backend)


def _mend(path: Path) -> None:
    """Remove a last line that a crash left incomplete: Optuna would append to it."""
    lock = JournalFileSymlinkLock(str(path))
    lock.acquire()
    try:
        with open(path, "r+b") as file:
            text = file.read()
            file.truncate(text.rfind(b"\n") + 1)
    finally:
        lock.release()


def _pruner(search: Search) -> optuna.pruners.BasePruner:
    if search.pruner is None:
        return optuna.pruners.NopPruner()
    trials, steps = search.pruner
    return optuna.pruners.MedianPruner(n_startup_trials=trials, n_warmup_steps=steps)


def _check_same(known: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Check that two contents of a search's file differ in nothing that determines results."""
    names = sorted((known.keys() | wanted.keys()) - set(MAY_CHANGE))
    # Through JSON, as the study keeps it.
    values = json.loads(json.dumps(dict(wanted)))
    changed = [name for name in names if known.get(name) != values.get(name)]
    if changed:
        raise ValueError(
            f"{', '.join(changed)}: differs from the search in the folder, of which only "
            f"{', '.join(MAY_CHANGE)} may change: restore the file, or choose another --output"
        )
