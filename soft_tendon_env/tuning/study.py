"""Studies of Optuna: trials side by side and on several machines that share a folder.

It also tells what they found.
"""

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
    """The study in a folder, which machines may share, made where it is not there.

    Raises:
        ValueError: it is of another search.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    pruner = optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=1)
    log = JournalFileBackend(str(folder / "study.log"))
    study = optuna.create_study(
        storage=JournalStorage(log), study_name="study", load_if_exists=True, pruner=pruner
    )
    begun = study.user_attrs.get("search")
    table = search.model_dump(mode="json", exclude={"trials", "finalists"})
    if begun is None:
        study.set_user_attr("search", table)
        first = search.first_values()
        if first:
            # the best of the study is then never worse than what is in use, on its seeds
            study.enqueue_trial(first)
        return study
    differences = []
    for key, value in table.items():
        value_before = begun.get(key)
        if value_before != value:
            difference = f"{key} was {shown(value_before)} and is {shown(value)}"
            differences.append(difference)
    if differences:
        text = "; ".join(differences)
        raise ValueError(f"{folder} has another search, {text}: give another --out")
    return study


def run_trial(search: Search, folder: Path, _: int = 0) -> None:
    """One more trial, unless there are as many as there should be.

    It has its values and its error as attributes.
    """
    study = open_study(search, folder)
    if len(study.get_trials(states=DONE)) >= search.trials:
        return
    # none has the seed of another machine's
    seed = search.seed + len(study.trials)
    study.sampler = TPESampler(seed=seed, constant_liar=True)

    def cost(trial: optuna.Trial) -> float:
        values = {}
        for name, parameter in search.search.items():
            values[name] = parameter.suggest(trial, name)
        trial.set_user_attr("values", values)
        reports: list[float] = []

        def report(cost_so_far: float) -> None:
            trial.report(cost_so_far, len(reports))
            reports.append(cost_so_far)
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
    """Runs the missing trials of a study and returns the best of all.

    It is printed, and trials.csv and best.toml are written into the folder. Where there are
    finalists, the best is that of the least cost in the finals.

    Args:
        search: what is searched.
        folder: of the study.
        workers: trials side by side.
        cluster: address of a Ray cluster that runs them; None: this machine does.

    Returns:
        The best trial.

    Raises:
        ValueError: the cluster cannot be reached.
        UserError: no trial was successful.
    """
    study = open_study(search, folder)
    done = len(study.get_trials(states=DONE))
    missing = range(done, search.trials)
    one_more = partial(run_trial, search, folder)
    run_all(one_more, missing, workers, "study", unit="trial", cluster=cluster)
    trials = study.get_trials(states=DONE)
    complete = [trial for trial in trials if trial.state is TrialState.COMPLETE]
    finalists = _finalists(complete, search.finalists)
    play_final = partial(_final_cost, search.of_finals(), folder)
    finals = {}
    if finalists:
        costs = run_all(play_final, finalists, workers, "finals", unit="trial", cluster=cluster)
        numbers = [trial.number for trial in finalists]
        finals = dict(zip(numbers, costs, strict=True))
    rows = [_table_row(trial, finals.get(trial.number)) for trial in trials]
    write_csv(folder / "trials.csv", rows)
    if not complete:
        errors = [trial.user_attrs["error"] for trial in trials if "error" in trial.user_attrs]
        first = ""
        if errors:
            first = f", the first: {errors[0]}"
        raise UserError(f"none of {len(trials)} trials was successful{first}")
    pruned = sum(trial.state is TrialState.PRUNED for trial in trials)
    print(f"{len(trials)} trials: {len(complete)} complete, {pruned} pruned")
    best = min(complete, key=_cost)
    for trial in finalists:
        cost = finals[trial.number]
        print(f"trial {trial.number}: {_shown(_cost(trial))}, in the finals {_shown(cost)}")
        if cost < finals[best.number]:
            best = trial
    values = best.user_attrs["values"]
    print(f"best: trial {best.number}, {_shown(_cost(best))}, {values}")
    path = folder / "best.toml"
    table = search.file(values)
    path.write_text(tomli_w.dumps(table))
    print(f"written: {path}")
    return best


def _finalists(complete: list[FrozenTrial], count: int) -> list[FrozenTrial]:
    """So many trials of least cost, and trial 0, which has the values in use."""
    if not count:
        return []
    ranked = sorted(complete, key=_cost)
    finalists = ranked[:count]
    in_use = [trial for trial in ranked[count:] if trial.number == 0]
    return finalists + in_use


def _final_cost(search: Search, folder: Path, trial: FrozenTrial) -> float:
    """Cost [m] of a finalist by a search on other seeds."""
    trial_folder = folder / f"trial_{trial.number}"
    with into_log(trial_folder / "final.log"):
        return search.final_cost(trial.user_attrs["values"], trial_folder)


def _cost(trial: FrozenTrial) -> float:
    """Cost [m] of a complete trial."""
    return trial.value or 0.0


def _shown(cost: float) -> str:
    """Cost [m] as text."""
    return f"{number(1e3 * cost)} mm"


def _table_row(trial: FrozenTrial, final_cost: float | None) -> dict[str, object]:
    """Row of a trial in trials.csv."""
    return {
        "trial": trial.number,
        "state": trial.state.name.lower(),
        "cost": trial.value,
        "cost in the finals": final_cost,
        **trial.params,
        "error": trial.user_attrs.get("error"),
    }
