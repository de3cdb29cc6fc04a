"""Studies of Optuna: trials by ask and tell, side by side and on several machines that share a journal file or a database."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import optuna
from optuna.pruners import BasePruner, HyperbandPruner, MedianPruner, NopPruner
from optuna.samplers import TPESampler
from optuna.storages import JournalStorage, get_storage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.messages import UserError, first_line
from soft_tendon_env.tuning.search import Search

MAY_CHANGE = {"trials"}
"""Keys of a search that may be other when its study goes on."""
SEARCH = "search"
"""Attribute of a study: the search that it is of."""
DONE = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)


class Work(NamedTuple):
    """Plain values that a process needs for a trial.

    storage: path of a journal file or URL of a database. name: name of the study. folder: folder of its trials.
    """

    search: Search
    storage: str
    name: str
    folder: Path


def open_study(work: Work) -> optuna.Study:
    """The study, made where it is not there. Raises ValueError where its storage cannot be opened, or has another search by its name."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        storage = get_storage(work.storage) if "://" in work.storage else JournalStorage(JournalFileBackend(work.storage))
        study = optuna.create_study(storage=storage, study_name=work.name, load_if_exists=True, pruner=_pruner(work.search))
        begun = study.user_attrs.get(SEARCH)
    except Exception as error:  # of a driver, of a database, of a file that is no journal
        raise ValueError(f"storage is {work.storage}: it cannot be opened, {first_line(error)}") from error
    own = work.search.model_dump(mode="json", exclude=MAY_CHANGE)
    if begun is None:
        study.set_user_attr(SEARCH, own)
        first = {key: work.search.search[key].name_of(value) for key, value in work.search.defaults.items()}
        if None not in first.values():
            study.enqueue_trial(first, skip_if_exists=True)
    elif changed := [key for key in own if begun.get(key) != own[key]]:
        differences = "; ".join(f"{key} was {shown(begun.get(key))} and is {shown(own[key])}" for key in changed)
        raise ValueError(f"{work.storage} has another search called {work.name}, {differences}: give another --out, or another --storage")
    return study


def _pruner(search: Search) -> BasePruner:
    """Pruners count the reports of a trial from 1."""
    if search.pruner == "hyperband":
        return HyperbandPruner(min_resource=1, max_resource=search.reports)
    return MedianPruner(n_startup_trials=5, n_warmup_steps=1) if search.pruner == "median" else NopPruner()


def done(study: optuna.Study) -> list[FrozenTrial]:
    """Trials that have ended, in whatever way."""
    return study.get_trials(states=DONE)


def folder_of(work: Work, trial: int) -> Path:
    """Folder of what a trial leaves, by its number."""
    return work.folder / f"trial_{trial}"


def run_trial(work: Work) -> None:
    """One more trial, unless there are as many as there should be: ask, search, tell."""
    study = open_study(work)
    if len(done(study)) >= work.search.trials:
        return
    trial = study.ask()
    study.sampler = TPESampler(seed=work.search.seed + trial.number, multivariate=False, constant_liar=True)  # none as another machine's
    values = {name: parameter.suggest(trial, name) for name, parameter in work.search.search.items()}
    folder = folder_of(work, trial.number)
    steps = 0

    def report(cost: float) -> None:
        nonlocal steps
        steps += 1
        trial.report(cost, steps)
        if trial.should_prune():
            raise optuna.TrialPruned

    try:
        with into_log(folder):
            cost = work.search.cost(values, folder, report)
    except optuna.TrialPruned:
        study.tell(trial, state=TrialState.PRUNED)
    except (ValueError, UserError) as error:
        trial.set_user_attr("error", str(error).partition("\n")[0])
        study.tell(trial, state=TrialState.FAIL) if isinstance(error, ValueError) else study.tell(trial, float("inf"))
    except BaseException:
        study.tell(trial, state=TrialState.FAIL)
        raise
    else:
        study.tell(trial, cost)


@contextlib.contextmanager
def into_log(folder: Path) -> Iterator[None]:
    """Sends what is printed meanwhile into a file of the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "trial.log", "a") as log, contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
        yield


def values_of(search: Search, trial: FrozenTrial) -> dict[str, Any]:
    """Values of the parameters of a trial that is over."""
    fixed = optuna.trial.FixedTrial(trial.params)
    return {name: parameter.suggest(fixed, name) for name, parameter in search.search.items()}


def trial_records(trials: Sequence[FrozenTrial]) -> list[dict[str, Any]]:
    """Rows of a table of trials: number, state, cost [m] (of a pruned one, when it ended), parameters, seconds and error."""
    return [
        {
            "trial": trial.number,
            "state": trial.state.name.lower(),
            "cost": trial.value,
            **trial.params,
            "seconds": None if trial.duration is None else round(trial.duration.total_seconds(), 1),
            "error": trial.user_attrs.get("error"),
        }
        for trial in trials
    ]
