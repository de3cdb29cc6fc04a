"""Tuning from beginning to end: trials, the best parameters as a file, and whether they are better than the defaults on other episodes."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from optuna.trial import FrozenTrial, TrialState

from soft_tendon_env.evaluation.summaries import Interval, Tails, bootstrap_interval, interquartile_mean
from soft_tendon_env.evaluation.tables import markdown_table, number, write_csv
from soft_tendon_env.tools.configuration import override, parsed_changes, read_toml
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.parallel import run_all
from soft_tendon_env.tools.types import Array
from soft_tendon_env.tuning.controllers import ControllerSearch
from soft_tendon_env.tuning.search import Search
from soft_tendon_env.tuning.study import Work, done, folder_of, into_log, open_study, run_trial, trial_records, values_of

BEST_SHOWN = 5
MILLIMETRES = 1e3


def read_search(path: Path, changes: tuple[str, ...] = (), **more: Any) -> Search:
    """The search of a file, with `changes` "key=value" and `more` keys. Raises ConfigurationError, ValueError."""
    table = read_toml(path)
    override(table, parsed_changes(changes))
    table |= more
    if "training" not in table:
        return ControllerSearch.parse(table, str(path))
    from soft_tendon_env.tuning.trainings import TrainingSearch

    return TrainingSearch.parse(table, str(path))


def tune(work: Work, workers: int, cluster: str | None = None) -> FrozenTrial:
    """The best trial, once those that are missing have been run: prints the best, and writes trials.csv and best.toml into `work.folder`.

    Raises ValueError where the storage or the cluster cannot be opened, UserError where no trial was successful.
    """
    study = open_study(work)
    missing = work.search.trials - len(done(study))
    if missing > 0:
        run_all(run_trial, [work] * missing, workers, work.name, unit="trial", cluster=cluster)
    trials = done(study)
    write_csv(work.folder / "trials.csv", trial_records(trials))
    ended = [(float(trial.value or 0.0), trial) for trial in trials if trial.state is TrialState.COMPLETE]
    complete = sorted((pair for pair in ended if math.isfinite(pair[0])), key=lambda pair: pair[0])
    if not complete:
        errors = [trial.user_attrs["error"] for trial in trials if "error" in trial.user_attrs]
        raise UserError(f"none of {len(trials)} trials was successful" + (f", the first: {errors[0]}" if errors else ""))
    names = list(work.search.search)
    rows = [
        (str(trial.number), number(MILLIMETRES * cost), *(_short(trial.params[name]) for name in names))
        for cost, trial in complete[:BEST_SHOWN]
    ]
    counts = f"{len(trials)} trials: {len(complete)} complete, {sum(trial.state is TrialState.PRUNED for trial in trials)} pruned"
    print(f"{counts}\n\n{markdown_table(('trial', 'cost [mm]', *names), rows)}\n")
    best = complete[0][1]
    with open(work.folder / "best.toml", "wb") as file:
        tomli_w.dump(work.search.file(values_of(work.search, best)), file)
    print(f"written: {work.folder / 'best.toml'}")
    return best


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class Comparison(NamedTuple):
    """Costs [m] of the defaults and of the best parameters on other episodes: interquartile means, the interval of their difference, and
    the tails of both."""

    default: float
    best: float
    difference: float
    interval: Interval
    tails: tuple[Tails, Tails]

    def __str__(self) -> str:
        low, high = (MILLIMETRES * float(bound) for bound in self.interval)
        costs = (number(MILLIMETRES * cost) for cost in (self.default, *self.tails[0], self.best, *self.tails[1]))
        said = "defaults {} mm (mean {}, p90 {}), best {} mm (mean {}, p90 {})".format(*costs)
        verdict = "better than the defaults" if high < 0.0 else "worse than the defaults" if low > 0.0 else "not better than the defaults"
        return f"{said}, difference {MILLIMETRES * self.difference:+.3g} mm [{low:+.3g}, {high:+.3g}]: {verdict}"


def _judge(judged: tuple[Search, Path, dict[str, Any]]) -> Array:
    search, folder, values = judged
    with into_log(folder):
        return search.judge(values, folder)


def compare(work: Work, best: FrozenTrial, workers: int, cluster: str | None = None) -> Comparison:
    """The best parameters beside the defaults, pair by pair of episodes (and seeds of training). Raises ValueError, UserError."""
    others = folder_of(work, best.number) / "others"
    judged = [(work.search, work.folder / "default", {}), (work.search, others, values_of(work.search, best))]
    defaults, found = run_all(_judge, judged, workers, "on other episodes", cluster=cluster)
    differences = found - defaults
    usual, tuned, difference = (float(interquartile_mean(costs.ravel())) for costs in (defaults, found, differences))
    interval = bootstrap_interval(differences, axes=np.ndim(differences))
    return Comparison(usual, tuned, difference, interval, (Tails.of(defaults), Tails.of(found)))
