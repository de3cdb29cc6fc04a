"""Settings of evaluations and comparisons, and their runs: one policy, or many in several processes, on the evaluation episodes."""

import math
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Annotated, Any, NamedTuple

import gymnasium as gym
from pydantic import AfterValidator, Field, field_validator, model_validator
from tqdm import tqdm

from soft_tendon_env.envs import IDS, Options
from soft_tendon_env.evaluation import EVALUATION_SEEDS, MODEL_ERRORS, EpisodeScore, evaluate, model_error
from soft_tendon_env.policies.agent import ARM, INTERFACE, caveats, is_agent
from soft_tendon_env.policies.load import ALL, load_policy, policy_options
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, plain, shown
from soft_tendon_env.tools.types import NotNegative, Positive


def _known_task(name: str) -> str:
    if name not in IDS:
        raise ValueError(f"should be a task: {not_among(name, IDS)}")
    return name


TaskName = Annotated[str, AfterValidator(_known_task)]
"""The name of a registered task."""


Seed = Annotated[int, Field(ge=0)]
"""Of `reset`."""


class EpisodeSettings(Configuration):
    """What an episode of an evaluation is.

    Attributes:
        seconds: length of an episode [s].
        skip: time at the beginning of an episode that errors leave out [s].
        options: more options of the environment, see `soft_tendon_env.envs.Options`; of `randomize`, what every arm has, unless a model
            error says otherwise.
    """

    seconds: Positive = 10.0
    skip: NotNegative = 1.0
    options: dict[str, Any] = Field(default={})

    @field_validator("options")
    @classmethod
    def _of_an_environment(cls, options: dict[str, Any]) -> dict[str, Any]:
        Options.parse(options, "options")
        return options


class Settings(EpisodeSettings):
    """What an evaluation is over.

    Attributes:
        errors: names of soft_tendon_env.evaluation.MODEL_ERRORS, several of them at once with commas between, as in
            stiffness+20%,payload-20g,noise; or "all", one by one.
        episodes: how many of the evaluation seeds, from the first.
        seeds: of the episodes, in place of those.
    """

    errors: tuple[str, ...] = Field(default=tuple(MODEL_ERRORS), min_length=1)
    episodes: int = Field(default=len(EVALUATION_SEEDS), ge=1)
    seeds: tuple[Seed, ...] = Field(default_factory=lambda given: EVALUATION_SEEDS[: given.get("episodes", 0)], min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _counted(cls, values: dict[str, Any]) -> dict[str, Any]:
        """As many episodes as there are seeds."""
        seeds = values.get("seeds")
        return {"episodes": len(seeds), **values} if isinstance(seeds, tuple) and seeds else values

    @field_validator("errors")
    @classmethod
    def _known(cls, errors: tuple[str, ...]) -> tuple[str, ...]:
        every = [name for given in errors for name in (MODEL_ERRORS if given == ALL else (given,))]
        for name in every:
            model_error(name)
        return tuple(dict.fromkeys(every))

    @field_validator("seeds")
    @classmethod
    def _differ(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if twice := [seed for seed in dict.fromkeys(seeds) if seeds.count(seed) > 1]:
            raise ValueError(f"should have each seed once, not {twice[0]} several times")
        return seeds

    @model_validator(mode="after")
    def _fit(self) -> "Settings":
        if self.episodes != len(self.seeds):
            given, count = "seeds" in self.model_fields_set, len(self.seeds)
            allowed = f"{count}, as there are seeds" if given else f"at most {count}, or seeds should be given in its place"
            raise ConfigurationError([Problem(("episodes",), f"is {self.episodes}: it should be {allowed}")])
        return self


MOST_STEPS = 1_000_000
"""Of an episode: beyond, memory for what is kept of every step runs out."""


def episode_steps(seconds: float, skip: float, options: Mapping[str, Any]) -> int:
    """Control periods of an episode in an environment with these options. Raises ConfigurationError, ValueError."""
    period = Options.parse(options, "options").control_period
    steps = seconds / period
    if steps > MOST_STEPS:
        raise ValueError(f"seconds is {seconds:g}: it should be at most {MOST_STEPS} control periods, {MOST_STEPS * period:g} s")
    if round(steps) < 1 or math.ceil(skip / period - 1e-9) > round(steps):
        raise ValueError(f"seconds is {seconds:g}: it should be at least one control period, {period:g} s, and skip, which is {skip:g}")
    return round(steps)


class Comparison(Settings):
    """What is compared: the keys of a file such as configs/compare.toml.

    Attributes:
        tasks: that policies are compared on.
        policies: names of controllers, "all" of them, "agent" (which ships), folders or .zip files of agents, or folders of runs.
        workers: processes.
        episode_csv: whether to write TASK_episodes.csv too, every episode in few numbers.
    """

    tasks: tuple[TaskName, ...] = Field(default_factory=lambda: tuple(IDS), min_length=1, json_schema_extra={"flag": "--task"})
    policies: tuple[str, ...] = Field(default=(ALL,), min_length=1)
    workers: int = Field(default=2, ge=1)
    episode_csv: bool = False


class Run(NamedTuple):
    """One policy on one arm, over the episodes. Plain values: worker processes get it."""

    task: str
    policy: str
    error: str
    options: dict[str, Any]
    seeds: tuple[int, ...]
    seconds: float
    skip: float


def make_run(
    settings: EpisodeSettings, seeds: tuple[int, ...], task: str, policy: str, error: str, options: Mapping[str, Any] | None = None
) -> Run:
    """options: of the arm, those of the settings by default. Raises ValueError, OSError."""
    resolved = policy_options(policy, task, settings.options if options is None else options)
    return Run(task, policy, error, resolved, seeds, settings.seconds, settings.skip)


def make_env(run: Run) -> gym.Env[Any, Any]:
    """Raises ConfigurationError, ValueError."""
    steps = episode_steps(run.seconds, run.skip, run.options)
    randomize = {**plain(run.options.get("randomize", {})), **model_error(run.error)}
    return gym.make(IDS[run.task], max_episode_steps=steps, **{**run.options, "randomize": randomize})


def print_caveats(settings: EpisodeSettings, runs: Sequence[Run]) -> None:
    """On the error stream, what should be known of the arm and of the agents among the policies. Raises ValueError, OSError."""
    of_agents = caveats({run.policy: (run.task, run.options) for run in runs if is_agent(run.policy)})
    for text in [*_of_every_arm(settings), *_borrowed(settings, runs), *of_agents]:
        print(f"note: {text}", file=sys.stderr)


def _of_every_arm(settings: EpisodeSettings) -> list[str]:
    """What model errors come on top of, in a line."""
    randomize = settings.options.get("randomize")
    return [f"every arm, the nominal one too, has randomize = {shown(plain(randomize))}"] if randomize else []


def _borrowed(settings: EpisodeSettings, runs: Sequence[Run]) -> list[str]:
    """Which controllers act on an arm that nobody gave, since it is the agents', in lines."""
    found: dict[str, dict[str, None]] = {}
    for run in runs:
        own = [f"{key} = {shown(run.options[key])}" for key in ARM if key in run.options and key not in settings.options]
        if own and not is_agent(run.policy):
            found.setdefault(", ".join(own), {})[run.policy] = None
    return [f"{', '.join(names)}: on the arm of the agents beside, {arm}" for arm, names in found.items()]


def scores_of(run: Run, progress: bool = False) -> list[EpisodeScore]:
    """Scores of all episodes of a run."""
    env = make_env(run)
    seeds = tqdm(run.seeds, desc=f"{run.policy}, {run.error}", unit="episode", leave=False, disable=not progress)
    return evaluate(load_policy(run.policy, env), env, seeds, run.skip)


def all_scores(runs: Sequence[Run], workers: int, label: str) -> list[list[EpisodeScore]]:
    """The scores of every run, each in one of the processes."""
    bar = {"desc": label, "total": len(runs), "unit": "run", "leave": False}
    if workers == 1:
        return [scores_of(run) for run in tqdm(runs, **bar)]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of the workers: they are as many as there are cores
    with ProcessPoolExecutor(min(workers, len(runs)), get_context("spawn")) as pool:
        return list(tqdm(pool.map(scores_of, runs), **bar))


def episode_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """What makes episodes of one environment those of another, as resolved: all but what a policy sees and how its actions are read."""
    return {key: value for key, value in Options(**options).model_dump(mode="json").items() if key not in INTERFACE}
