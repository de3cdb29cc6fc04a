"""Studies of Optuna: trials side by side and on several machines that share a journal file or a database, and what they found."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import optuna
import tomli_w
from optuna.samplers import TPESampler
from optuna.storages import JournalStorage, get_storage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from soft_tendon_env.evaluation.tables import markdown_table, number, write_csv
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.messages import UserError, first_line
from soft_tendon_env.tools.parallel import run_all
from soft_tendon_env.tuning.search import Search

DONE = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
BEST_SHOWN = 5
MILLIMETRES = 1e3


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
    pruner = optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=1)
    try:
        storage = get_storage(work.storage) if "://" in work.storage else JournalStorage(JournalFileBackend(work.storage))
        study = optuna.create_study(storage=storage, study_name=work.name, load_if_exists=True, pruner=pruner)
        begun = study.user_attrs.get("search")
    except Exception as error:  # of a driver, of a database, of a file that is no journal
        raise ValueError(f"storage is {work.storage}: it cannot be opened, {first_line(error)}") from error
    own = work.search.model_dump(mode="json", exclude={"trials"})
    if begun is None:
        study.set_user_attr("search", own)
        space, defaults = work.search.search, work.search.defaults
        within = {name: value for name, value in defaults.items() if space[name].contains(value)}
        first = {name: json.dumps(value) if space[name].choices else value for name, value in within.items()}
        study.enqueue_trial(first, skip_if_exists=True)
    elif changed := [key for key in own if begun.get(key) != own[key]]:
        differences = "; ".join(f"{key} was {shown(begun.get(key))} and is {shown(own[key])}" for key in changed)
        raise ValueError(f"{work.storage} has another search called {work.name}, {differences}: give another --out, or another --storage")
    return study


def run_trial(work: Work) -> None:
    """One more trial, unless there are as many as there should be: ask, search, tell."""
    study = open_study(work)
    if len(study.get_trials(states=DONE)) >= work.search.trials:
        return
    space = {name: parameter.distribution for name, parameter in work.search.search.items()}
    study.sampler = TPESampler(seed=work.search.seed + len(study.trials), constant_liar=True)  # none as another machine's
    trial = study.ask(space)

    def report(cost: float) -> None:
        trial.report(cost, len(reports))
        reports.append(cost)
        if trial.should_prune():
            raise optuna.TrialPruned

    reports = list[float]()
    folder = work.folder / f"trial_{trial.number}"
    try:
        with into_log(folder):
            cost = work.search.cost(decoded(work, trial.params), folder, report)
    except optuna.TrialPruned:
        study.tell(trial, state=TrialState.PRUNED)
    except BaseException as error:
        trial.set_user_attr("error", first_line(error))
        study.tell(trial, state=TrialState.FAIL)
        if not isinstance(error, ValueError | UserError):
            raise
    else:
        study.tell(trial, cost)


def decoded(work: Work, parameters: dict[str, Any]) -> dict[str, Any]:
    """Values by name, of a trial's parameters."""
    return {name: json.loads(value) if work.search.search[name].choices else value for name, value in parameters.items()}


@contextlib.contextmanager
def into_log(folder: Path) -> Iterator[None]:
    """Sends what is printed meanwhile into a file of the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "trial.log", "a") as log, contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
        yield


def tune(work: Work, workers: int, cluster: str | None = None) -> FrozenTrial:
    """The best trial, once those that are missing have been run: prints the best, and writes trials.csv and best.toml into `work.folder`.

    Raises ValueError where the storage or the cluster cannot be opened, UserError where no trial was successful.
    """
    study = open_study(work)
    missing = work.search.trials - len(study.get_trials(states=DONE))
    if missing > 0:
        run_all(run_trial, [work] * missing, workers, work.name, unit="trial", cluster=cluster)
    trials = study.get_trials(states=DONE)
    heads = [{"trial": trial.number, "state": trial.state.name.lower(), "cost": trial.value} for trial in trials]
    rows = zip(heads, trials, strict=True)
    write_csv(work.folder / "trials.csv", [{**head, **trial.params, "error": trial.user_attrs.get("error")} for head, trial in rows])
    complete = sorted((trial for trial in trials if trial.state is TrialState.COMPLETE), key=lambda trial: trial.value or 0.0)
    if not complete:
        errors = [trial.user_attrs["error"] for trial in trials if "error" in trial.user_attrs]
        raise UserError(f"none of {len(trials)} trials was successful" + (f", the first: {errors[0]}" if errors else ""))
    print(f"{len(trials)} trials: {len(complete)} complete, {sum(trial.state is TrialState.PRUNED for trial in trials)} pruned\n")
    shown_values = ([f"{value:.4g}" if isinstance(value, float) else str(value) for value in trial.params.values()] for trial in complete)
    costs = (number(MILLIMETRES * (trial.value or 0.0)) for trial in complete)
    best = [(str(trial.number), cost, *values) for trial, cost, values in zip(complete, costs, shown_values, strict=True)]
    print(f"{markdown_table(('trial', 'cost [mm]', *complete[0].params), best[:BEST_SHOWN])}\n")
    (work.folder / "best.toml").write_text(tomli_w.dumps(work.search.file(decoded(work, complete[0].params))))
    print(f"written: {work.folder / 'best.toml'}")
    return complete[0]
