"""Studies of Optuna: trials side by side and on several machines that share a folder, and what they
found."""

from functools import partial
from pathlib import Path

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


def open_study(search: Search, folder: Path) -> optuna.Study:
    """The study in a folder, which machines may share, made where it is not there. Raises
    ValueError where it is of another search."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    pruner = optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=1)
    storage = JournalStorage(JournalFileBackend(str(folder / "study.log")))
    study = optuna.create_study(
        storage=storage, study_name="study", load_if_exists=True, pruner=pruner
    )
    begun, table = (
        study.user_attrs.get("search"),
        search.model_dump(mode="json", exclude={"trials"}),
    )
    if begun is None:
        study.set_user_attr("search", table)
    elif changed := [key for key in table if begun.get(key) != table[key]]:
        differences = "; ".join(
            f"{key} was {shown(begun.get(key))} and is {shown(table[key])}" for key in changed
        )
        raise ValueError(f"{folder} has another search, {differences}: give another --out")
    return study


def run_trial(search: Search, folder: Path, _: int = 0) -> None:
    """One more trial, unless there are as many as there should be; it has its values and its error
    as attributes."""
    study = open_study(search, folder)
    if len(study.get_trials(states=DONE)) >= search.trials:
        return
    study.sampler = TPESampler(
        seed=search.seed + len(study.trials), constant_liar=True
    )  # none as another machine's

    def cost(trial: optuna.Trial) -> float:
        values = {name: parameter.suggest(trial, name) for name, parameter in search.search.items()}
        trial.set_user_attr("values", values)
        reports = list[float]()

        def report(found: float) -> None:
            trial.report(found, len(reports))
            reports.append(found)
            if trial.should_prune():
                raise optuna.TrialPruned

        trial_folder = folder / f"trial_{trial.number}"
        try:
            with into_log(trial_folder / "trial.log"):
                return search.cost(values, trial_folder, report)
        except (ValueError, UserError) as error:
            trial.set_user_attr("error", first_line(error))
            raise

    study.optimize(cost, n_trials=1, catch=(ValueError, UserError))


def tune(search: Search, folder: Path, workers: int, cluster: str | None = None) -> FrozenTrial:
    """The best trial, once those that are missing have been run: prints it, and writes trials.csv
    and best.toml into the folder.

    Raises ValueError where the cluster cannot be reached, UserError where no trial was successful.
    """
    study = open_study(search, folder)
    missing = range(len(study.get_trials(states=DONE)), search.trials)
    run_all(
        partial(run_trial, search, folder), missing, workers, "study", unit="trial", cluster=cluster
    )
    trials, rows = study.get_trials(states=DONE), list[dict[str, object]]()
    for trial in trials:
        head = {"trial": trial.number, "state": trial.state.name.lower(), "cost": trial.value}
        rows.append({**head, **trial.params, "error": trial.user_attrs.get("error")})
    write_csv(folder / "trials.csv", rows)
    complete, pruned = (
        sum(trial.state is state for trial in trials)
        for state in (TrialState.COMPLETE, TrialState.PRUNED)
    )
    if not complete:
        error = next(
            (
                f", the first: {trial.user_attrs['error']}"
                for trial in trials
                if "error" in trial.user_attrs
            ),
            "",
        )
        raise UserError(f"none of {len(trials)} trials was successful{error}")
    best = study.best_trial
    print(f"{len(trials)} trials: {complete} complete, {pruned} pruned")
    print(
        f"best: trial {best.number}, {number(1e3 * (best.value or 0.0))} mm,"
        f" {best.user_attrs['values']}"
    )
    (folder / "best.toml").write_text(tomli_w.dumps(search.file(best.user_attrs["values"])))
    print(f"written: {folder / 'best.toml'}")
    return best
