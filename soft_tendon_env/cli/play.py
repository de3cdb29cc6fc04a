"""`soft-tendon compare`, `evaluate`, `record`, `arena`, `demo`: policies on the same episodes, on the arm of their model and on arms that
differ. `soft-tendon reproduce-paper`: Figures 2 to 6 of the paper."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation import comparison, demo, tables
from soft_tendon_env.evaluation.benchmark import Benchmark, benchmark_tables, standings_by_regime
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS, SETTINGS
from soft_tendon_env.evaluation.entrants import agents_of, model_in_the_loop
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.settings import Comparison, EpisodeSettings, Seeds, Settings, TaskName, Workers
from soft_tendon_env.evaluation.summaries import summarise
from soft_tendon_env.policies.names import Agent, PolicyName
from soft_tendon_env.recording import RerunFile
from soft_tendon_env.tools.configuration import Configuration, read_toml
from soft_tendon_env.tools.files import CONFIGS
from soft_tendon_env.tools.parallel import check_cluster
from soft_tendon_env.tools.types import Positive

CONFIG = "TOML file with the keys of Comparison, such as configs/compare.toml, which other options override"
TASK = "name of the task: TipPose, Shape, Reach, or one that was registered"
POLICY = "a controller's name; an agent's folder; ppo, sac, dagger or apg, which ship for the task; agent, the best of these"


class Compare(Comparison):
    """Print errors by policy and model error, resuming where it was stopped, and write JSON with every episode, CSV, and a picture."""

    config: str | None = Field(default=None, description=CONFIG)
    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- compare TASK --> and its end")
    out: str = Field(default="out/compare", description="folder for results")

    @staticmethod
    def read_file(given: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of the file of --config, checked; episodes or seeds on the command line override both. Raises ConfigurationError."""
        table = read_toml(given["config"]) if "config" in given else {}
        Comparison.parse(table, given.get("config", ""))
        episodes = {"episodes", "seeds"}
        return {key: value for key, value in table.items() if not (key in episodes and episodes & given.keys())}


class Evaluate(Settings):
    """Print a row per model error, resuming where it was stopped, and write JSON with every episode, CSV, and a picture."""

    policy: str = Field(description=POLICY)
    task: TaskName = Field(default="TipPose", description=TASK)
    out: str = Field(default="out/evaluate", description="folder for results")


class Record(EpisodeSettings):
    """Print the errors of policies, and write a file for the Rerun viewer in which each has an arm of its name."""

    policies: tuple[str, ...] = Field(min_length=1, description=POLICY)
    task: TaskName = Field(default="TipPose", description=TASK)
    seeds: Seeds = Field(default=EVALUATION_SEEDS[:1], min_length=1, description="seeds of the episodes, which are played in turn")
    out: str = Field(default="out/side_by_side.rrd", description="file of the recording")


def run_evaluate(settings: Evaluate) -> None:
    """Evaluate, print and write."""
    play(settings, (settings.task,), (settings.policy,), settings.out)


def run_compare(settings: Compare) -> None:
    """Compare, print and write, task by task."""
    with mistakes():
        page = Page(settings.write_docs, [f"compare {task}" for task in settings.tasks])
    for task, text in play(settings, settings.tasks, settings.policies, settings.out).items():
        page.write(f"compare {task}", text)


def play(settings: Settings, tasks: Sequence[str], policies: tuple[str, ...], out: str) -> dict[str, str]:
    """Play policies under every model error, print and write results; returns tables by task. Raises Mistake."""
    folder = Path(out)
    with mistakes():
        require("pictures")
        files = {task: agents_of(task, policies) for task in tasks}
        arms = {task: comparison.shared_arms(settings, task, of_task) for task, of_task in files.items()}
        experiments = {task: comparison.compare(settings, task, of_task, folder / "cells") for task, of_task in arms.items()}
        check_cluster(settings.cluster)
        writable_folder(folder)
    from soft_tendon_env.evaluation.pictures import draw_errors

    what, texts = f"{len(settings.seeds)} episodes of {settings.seconds:g} s", dict[str, str]()
    print(f"{what}; {machine()}")
    for task, experiment in experiments.items():
        experiment.play(f"{task}: policies x model errors", settings.workers, settings.cluster)
        found, summaries = comparison.standings_of(experiment, files[task])
        errors = tables.error_table(found)
        texts[task] = f"{what.capitalize()}.\n\n{errors}"
        several = f"{errors}\n\n{tables.ERRORS_LEGEND}\n\n" if len(files[task]) > 1 else ""
        print(f"\n## {task}\n\n{several}{comparison.numbers_table(task, files[task], summaries)}\n")
        write_json(folder / f"{task}.json", {**origin(), **comparison.results_record(settings, task, arms[task], found, summaries)})
        tables.write_csv(folder / f"{task}.csv", tables.records(found))
        draw_errors({task: found}, folder / f"{task}.png")
    return texts


def run_record(settings: Record) -> None:
    """Record and print."""
    task, out = settings.task, Path(settings.out)
    with mistakes():
        require("recording")
        arms = comparison.shared_arms(settings, task, agents_of(task, settings.policies))
        players = {name: comparison.make_cell(settings, settings.seeds, task, name, arm).open() for name, arm in arms.items()}
        file = RerunFile(out)
    print(f"{task}, episodes of {settings.seconds:g} s from seeds {', '.join(map(str, settings.seeds))}; {machine()}\n")
    with file:
        scores = comparison.record_side_by_side(players, file, settings.seeds, settings.skip)
    summaries = {policy: summarise(of_policy) for policy, of_policy in scores.items()}
    models = {policy: model_in_the_loop(PolicyName.parse(policy, task)) for policy in summaries}
    print(f"{tables.summary_table('policy', summaries, models)}\n\n{comparison.opening_hint(out)}")


class Arena(Benchmark):
    """Play a benchmark of policies, resuming where it was stopped, and write its tables, CSV and picture."""

    config: str = Field(default="published", description="TOML file of a Benchmark, or a name that ships; other options override it")
    policies: tuple[str, ...] = Field(default=(), description="policies to compare in place of the file's, by their names for evaluate")
    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- arena TASK --> and its end")
    out: str = Field(default="out/arena", description="folder for results")

    @staticmethod
    def read_file(given: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of the file of --config, checked, with the entrants of --policies in place of its own. Raises ConfigurationError."""
        path = Path(given.get("config", "published"))
        shipped = CONFIGS / f"{path}.toml"
        path = path if path.exists() or not shipped.exists() else shipped
        table = {**read_toml(path), **({"entrants": [{"policy": policy} for policy in given["policies"]]} if "policies" in given else {})}
        Benchmark.parse(table, str(path))
        return table


def run_arena(settings: Arena) -> None:
    """Play what is missing, print and write."""
    with mistakes():
        require("pictures")
        out, marker = Path(settings.out), f"arena {settings.task}"
        page, (cells, notes) = Page(settings.write_docs, [marker]), settings.cells()
        experiment = Experiment(cells, out / "cells")
        check_cluster(settings.cluster)
        writable_folder(out)
    what = f"{settings.episodes} episodes of {settings.seconds:g} s"
    for note in notes:
        print(f"note: {note}")
    print(f"{len(experiment.cells)} cells, {len(experiment.missing())} of them to be played, {what} each; {machine()}", flush=True)
    experiment.play("arena", settings.workers, settings.cluster)
    from soft_tendon_env.evaluation.pictures import draw_errors

    found, picture = standings_by_regime(settings, experiment), out / "arena.png"
    if settings.write_docs is not None:
        picture = Path(settings.write_docs).with_suffix(".png")
    legend = "\n".join(f"- `{name}`: {SETTINGS[name].description}." for name in settings.settings)
    text = f"{benchmark_tables(settings, found)}\n\n{legend}"
    print(f"\n{text}\n")
    for path in {out / "arena.csv", picture.with_suffix(".csv")}:
        tables.write_csv(path, [{"regime": regime, **row} for regime, of in found.items() for row in tables.records(of)])
    draw_errors({f"information: {regime}": of for regime, of in found.items()}, picture)
    parts = [f"{what.capitalize()}.", *(f"Note: {note}." for note in notes)]
    page.write(marker, "\n\n".join([*parts, f"![Errors of all policies by setting and regime]({picture.name})", text]))


class Demo(Workers):
    """Print the errors of controllers and agents, and write a picture and a recording for the Rerun viewer."""

    episodes: int = Field(default=len(EVALUATION_SEEDS), ge=1, le=len(EVALUATION_SEEDS), description="number of random targets")
    seconds: Positive = Field(default=10.0, description="length of an episode [s]")
    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- demo --> and <!-- /demo -->")
    out: str = Field(default="out", description="folder of the picture, the recording and the episodes that were played")


def run_demo(settings: Demo) -> None:
    """Run all policies, print and write."""
    out = Path(settings.out)
    with mistakes():
        require("agents", "pictures", "recording")
        page = Page(settings.write_docs, ["demo"])
        check_cluster(settings.cluster)
        file = RerunFile(writable_folder(out) / "demo.rrd")
        known = CONTROLLERS[demo.TASK]
        configs = {name: Agent(policy, demo.TASK).config for policy, name in demo.SHOWN.items() if policy not in known}
        agents = {name: f"{config.algorithm}, {config.steps_done:,} steps" for name, config in configs.items()}
    described = {name: agents.get(name) or known[policy].description for policy, name in demo.SHOWN.items()}
    print("\n".join(f"{name:<24} {text}" for name, text in described.items()), "\n")
    shown = demo.run_demo(settings.episodes, settings.seconds, settings, file, out)
    print(f"{shown}\n\n{demo.NOTES}\n")
    trained = "; ".join(f"{name}: {text}" for name, text in agents.items())
    page.write("demo", f"Episodes of {settings.seconds:g} s. {trained}.\n\n{shown}\n\n{demo.NOTES}")
    print(comparison.opening_hint(out / "demo.rrd"))


Figure = Literal[2, 3, 4, 5, 6]
ALL: tuple[Figure, ...] = (2, 3, 4, 5, 6)
LONGEST = 10.0  # [s] of all motions


class ReproducePaper(Configuration):
    """Draw figures 2 to 6 of the paper, and print what it says of them beside what is measured."""

    figures: tuple[Figure, ...] = Field(default=ALL, min_length=1, description="figures to draw; 3 and 4 belong together, 5 and 6 too")
    seconds: Annotated[float, Field(ge=1.0, le=LONGEST, description="end every motion after this time [s], to try it out")] = LONGEST
    write_docs: str | None = Field(default=None, description="file in which all goes between <!-- figures --> and <!-- /figures -->")
    out: str = Field(default="out/paper", description="folder of pictures and numbers")


def run_reproduce_paper(settings: ReproducePaper) -> None:
    """Draw, print and write."""
    with mistakes():
        require("pictures")
        if settings.write_docs is not None and (settings.seconds < LONGEST or {*settings.figures} != {*ALL}):
            raise ValueError(f"--write-docs needs all figures and {LONGEST:g} seconds")
        page, out = Page(settings.write_docs, ["figures"]), writable_folder(Path(settings.out))
    from soft_tendon_env.paper.reproduce import document, reproduce

    results = reproduce(settings.figures, settings.seconds, out)
    if settings.write_docs is not None:
        page.write("figures", document(results))
