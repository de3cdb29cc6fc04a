"""Studies of Optuna: trials side by side and on several machines that share a folder, and what they found."""

from pathlib import Path
from typing import NamedTuple

import optuna
import tomli_w
from optuna.samplers import TPESampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from soft_tendon_env.evaluation.tables import number, write_csv
from soft_tendon_env.learning.sweep import into_log
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.messages import UserError, first_line
from soft_tendon_env.tools.parallel import run_all
from soft_tendon_env.tuning.search import Search

DONE = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
MILLIMETRES = 1e3


class Work(NamedTuple):
    """A search, and the folder of its trials and its journal, which machines that work on it share."""

    search: Search
    folder: Path


def open_study(work: Work) -> optuna.Study:
    """The study, made where it is not there. Raises ValueError where the folder has another search."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    pruner = optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=1)
    storage = JournalStorage(JournalFileBackend(str(work.folder / "study.log")))
    study = optuna.create_study(storage=storage, study_name="study", load_if_exists=True, pruner=pruner)
    begun, own = study.user_attrs.get("search"), work.search.model_dump(mode="json", exclude={"trials"})
    if begun is None:
        study.set_user_attr("search", own)
    elif changed := [key for key in own if begun.get(key) != own[key]]:
        differences = "; ".join(f"{key} was {shown(begun.get(key))} and is {shown(own[key])}" for key in changed)
        raise ValueError(f"{work.folder} has another search, {differences}: give another --out")
    return study


def run_trial(work: Work) -> None:
    """One more trial, unless there are as many as there should be; it has its values and its error as attributes."""
    study = open_study(work)
    if len(study.get_trials(states=DONE)) >= work.search.trials:
        return
    study.sampler = TPESampler(seed=work.search.seed + len(study.trials), constant_liar=True)  # none as another machine's

    def cost(trial: optuna.Trial) -> float:
        values = {name: parameter.suggest(trial, name) for name, parameter in work.search.search.items()}
        trial.set_user_attr("values", values)
        reports = list[float]()

        def report(found: float) -> None:
            trial.report(found, len(reports))
            reports.append(found)
            if trial.should_prune():
                raise optuna.TrialPruned

        folder = work.folder / f"trial_{trial.number}"
        try:
            with into_log(folder / "trial.log"):
                return work.search.cost(values, folder, report)
        except (ValueError, UserError) as error:
            trial.set_user_attr("error", first_line(error))
            raise

    study.optimize(cost, n_trials=1, catch=(ValueError, UserError))


def tune(work: Work, workers: int, cluster: str | None = None) -> FrozenTrial:
    """The best trial, once those that are missing have been run: prints it, and writes trials.csv and best.toml into `work.folder`.

    Raises ValueError where the cluster cannot be reached, UserError where no trial was successful.
    """
    study = open_study(work)
    missing = work.search.trials - len(study.get_trials(states=DONE))
    if missing > 0:
        run_all(run_trial, [work] * missing, workers, "study", unit="trial", cluster=cluster)
    trials = study.get_trials(states=DONE)
    heads = [{"trial": trial.number, "state": trial.state.name.lower(), "cost": trial.value} for trial in trials]
    rows = zip(heads, trials, strict=True)
    write_csv(work.folder / "trials.csv", [{**head, **trial.params, "error": trial.user_attrs.get("error")} for head, trial in rows])
    complete = [trial for trial in trials if trial.state is TrialState.COMPLETE]
    if not complete:
        errors = [trial.user_attrs["error"] for trial in trials if "error" in trial.user_attrs]
        raise UserError(f"none of {len(trials)} trials was successful" + (f", the first: {errors[0]}" if errors else ""))
    best, pruned = study.best_trial, sum(trial.state is TrialState.PRUNED for trial in trials)
    print(f"{len(trials)} trials: {len(complete)} complete, {pruned} pruned")
    print(f"best: trial {best.number}, {number(MILLIMETRES * (best.value or 0.0))} mm, {best.user_attrs['values']}")
    (work.folder / "best.toml").write_text(tomli_w.dumps(work.search.file(best.user_attrs["values"])))
    print(f"written: {work.folder / 'best.toml'}")
    return best
