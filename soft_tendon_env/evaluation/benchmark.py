"""Benchmark of policies on arms that none of them was made for: the same task, information and episodes for all, as cells of an experiment.

The conditions stand in conditions.py, the statistics in summaries.py.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

from pydantic import Field, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import groups_of
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.evaluation.conditions import AND, SEEDS, SETTINGS, condition
from soft_tendon_env.evaluation.entrants import agents_of
from soft_tendon_env.evaluation.experiment import Cell, Experiment
from soft_tendon_env.evaluation.settings import RegimeNames, SettingNames, TaskName, Workers, episode_steps
from soft_tendon_env.evaluation.summaries import Duel, Standing, Standings, compared
from soft_tendon_env.policies.agent_checks import CLOCK
from soft_tendon_env.policies.agent_files import INTERFACE
from soft_tendon_env.policies.names import Agent, Controller, PolicyName
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import NotNegative, Positive

PLANT = "fine"
"""Fidelity of the arm that the benchmark is played on."""


class BenchmarkPolicy(Configuration):
    """One policy of the benchmark.

    Attributes:
        policy: a controller with a state estimator, such as filtered:predictive or adaptive:tracking@fast, see `load_policy`; the folder
            or .zip file of an agent, or agent, ppo, sac, dagger or apg, of those that ship; a folder of runs seed_0, seed_1, ..., as
            `soft-tendon sweep` leaves them; or `module:name`.
        seeds: a folder of runs that takes the place of `policy` if it exists.
        optional: leave the policy out, with a note, if its files are missing or no regime suffices for it; otherwise that is an error.
        name: in tables, by default `policy`.
        regimes: in which it is evaluated, by default all whose observations suffice for it.
        settings: in which it is evaluated, by default all.
        told: the model of a controller includes the effects of the setting, with the numbers of `Condition.scene`, not those that an
            episode draws: fluid at rest, no load where loads are drawn about zero.
    """

    policy: str
    seeds: str | None = None
    optional: bool = False
    name: str = ""
    regimes: RegimeNames = ()
    settings: SettingNames = ()
    told: bool = False

    @property
    def label(self) -> str:
        """Its name in tables."""
        return self.name or self.policy

    @property
    def policy_name(self) -> str:
        """Name of what plays: `seeds` where there is such a folder, else `policy`."""
        return self.policy if self.seeds is None or not Path(self.seeds).is_dir() else self.seeds

    def members(self, task: str) -> dict[int | None, PolicyName]:
        """Policies of which it consists, by seed of training; None: the only one. Raises ValueError, OSError for what is none."""
        (files,) = agents_of(task, [self.policy_name]).values()
        return {seed: PolicyName.parse(file, task) for seed, file in files.items()}


class Label(NamedTuple):
    """Name of a cell: a policy's label, its seed of training, and the names of the condition."""

    policy: str
    seed: int | None
    regime: str
    setting: str


class Benchmark(Workers):
    """Policies and conditions of the benchmark: the keys of a file such as configs/published.toml.

    Every policy is evaluated in all settings, in every regime that suffices for it.

    Attributes:
        task: name of the task: TipPose, Shape, Reach, or one that was registered.
        scene: a shipped scene's name, or the path of a TOML file: the arm that every policy may know.
        entrants: tables of the policies that are compared, see soft_tendon_env.evaluation.benchmark.BenchmarkPolicy.
        settings: names of model errors and loads, see soft_tendon_env.evaluation.conditions.
        regimes: names of sensor sets that policies observe, see soft_tendon_env.policies.regimes.
        target: the environment's option: what all follow.
        episodes: number of episodes of every policy in every condition, on the first of the test seeds.
        episodes_per_seed: least number of these episodes that each training seed is evaluated on, in turn, so that the seeds together cover
            all; None: every seed is evaluated on all.
        seconds: length of an episode [s].
        skip: time at the beginning of an episode that errors leave out [s].
    """

    task: TaskName = "TipPose"
    scene: str = "paper"
    entrants: tuple[BenchmarkPolicy, ...] = Field(min_length=1)
    settings: SettingNames = tuple(SETTINGS)
    regimes: RegimeNames = tuple(REGIMES)
    target: dict[str, Any] = Field(default={"type": "random", "fraction": 0.4, "knot_period": 0.6})
    episodes: int = Field(default=20, ge=1, le=len(SEEDS["arena"]))
    episodes_per_seed: int | None = Field(default=None, ge=1)
    seconds: Positive = 6.0
    skip: NotNegative = 1.0

    @model_validator(mode="after")
    def _fits(self) -> "Benchmark":
        labels = [entrant.label for entrant in self.entrants]
        if twice := [label for label in dict.fromkeys(labels) if labels.count(label) > 1]:
            raise ConfigurationError([Problem(("entrants",), f"has {twice[0]!r} several times: give each a name of its own")])
        episode_steps(self.seconds, self.skip, {"target": self.target})
        return self

    def present(self) -> tuple[Self, list[str]]:
        """The benchmark without policies of other regimes or settings and optional ones that cannot play, and a line for each of the latter
        and for everyone who plays without its seeds of training. Raises as `cells`, ValueError where nobody is left."""
        entrants, notes = list[BenchmarkPolicy](), list[str]()
        for entrant in self.entrants:
            try:
                if not list(self._cells_of(entrant)):
                    continue  # its regimes or settings are none of the chosen ones
            except (ValueError, OSError) as error:
                if not entrant.optional:
                    raise
                notes.append(f"{entrant.label} is left out: {error}")
                continue
            entrants.append(entrant)
            if entrant.seeds not in (None, entrant.policy_name):
                notes.append(f"{entrant.label} is a single training, {entrant.policy_name}: there is no folder {entrant.seeds} of several")
        if not entrants:
            raise ValueError(f"nobody can play: {'; '.join(notes) or 'all entrants are for other regimes or settings'}")
        return self.model_copy(update={"entrants": tuple(entrants)}), notes

    def cells(self) -> dict[Label, Cell]:
        """All that is to be played. Raises ValueError, OSError for policies that cannot play, or cannot play anywhere."""
        return {label: cell for entrant in self.entrants for label, cell in self._cells_of(entrant)}

    def _cells_of(self, entrant: BenchmarkPolicy) -> Iterator[tuple[Label, Cell]]:
        members, reasons, plays = entrant.members(self.task), dict[str, None](), False
        own = max(self.episodes_per_seed or self.episodes, -(-self.episodes // len(members)))
        for place, (seed, policy) in enumerate(members.items()):
            episodes = tuple(SEEDS["arena"][(place * own + k) % self.episodes] for k in range(min(own, self.episodes)))
            for regime in (name for name in self.regimes if name in (entrant.regimes or self.regimes)):
                observed = interface_options(policy, regime)
                if reason := misfit(policy, {"scene": self.scene, **observed}, regime):
                    reasons[f"{regime}: {reason}"] = None
                    continue
                plays = True
                for setting in (name for name in self.settings if name in (entrant.settings or self.settings)):
                    given = {**observed, "scene": self.scene, "fidelity": PLANT, "target": self.target}
                    options = condition(f"{regime}{AND}{setting}").options(given)
                    told = {"scene": self.scene, **(SETTINGS[setting].scene(load_scene(self.scene)) if entrant.told else {})}
                    cell = Cell(self.task, policy.text, options, episodes, self.seconds, self.skip, told=told)
                    yield Label(entrant.label, seed, regime, setting), cell
        if reasons and not plays:
            only = "policies may observe what does not depend on the discretisation of the arm"
            raise ValueError(f"{entrant.label} can play in no regime ({'; '.join(reasons)}): {only}, see REGIMES in policies/regimes.py")


def interface_options(policy: PolicyName, regime: str) -> dict[str, Any]:
    """Options of an environment in which a policy observes what it needs within a regime; users' policies, unless they say otherwise, all
    that the task has and the regime allows. Raises ValueError, OSError."""
    if isinstance(policy, Controller):
        return policy.options({}, None if policy.estimator is None else regime)
    if isinstance(policy, Agent):
        return {key: value for key, value in policy.options({}).items() if key in INTERFACE}
    allowed = REGIMES[regime]
    observable = [name for name in allowed.groups if name in TASKS[policy.task].observable]
    return {"observation": observable, "sensors": allowed.sensors or (), **policy.options({})}


def misfit(policy: PolicyName, options: Mapping[str, Any], regime: str) -> str:
    """Reason why a policy that observes what these options say cannot play in a regime; "": it can. Raises ValueError."""
    parsed, allowed = Options.parse(dict(options), "options"), REGIMES[regime]
    if isinstance(policy, Agent) and policy.arm.get(CLOCK, parsed.control_period) != parsed.control_period:
        return f"it was trained with {CLOCK} = {policy.arm[CLOCK]}"
    groups = groups_of(parsed, TASKS[policy.task])
    if beyond := [name for name in groups if name not in allowed.groups]:
        return f"it observes {', '.join(beyond)}"
    count = parsed.sensors if isinstance(parsed.sensors, int) else len(parsed.sensors)
    return f"it has {count} strain sensors" if "strain" in groups and count > allowed.sensors else ""


class Results(NamedTuple):
    """Results of a benchmark: standings by policy and setting, of every regime; which policies are controllers."""

    benchmark: Benchmark
    controllers: frozenset[str]
    of: Mapping[str, Standings]

    def best(self, regime: str, setting: str, learned: bool) -> tuple[str, Standing] | None:
        """Policy with the least error under a condition, among those that have learned or that have not; None: nobody plays there."""
        found = [(name, own) for (name, of), own in self.of[regime].items() if of == setting and (name not in self.controllers) == learned]
        return min(found, key=lambda own: own[1].mean(f"{own[1].error}_rms").value, default=None)

    def duels(self) -> Iterator[tuple[str, str, tuple[str, Standing], tuple[str, Standing], Duel]]:
        """Under every condition where both kinds play: the best that has learned, the best controller, and how they compare."""
        for regime, of in self.of.items():
            for setting in dict.fromkeys(setting for _, setting in of):
                learned, other = (self.best(regime, setting, own) for own in (True, False))
                if learned is not None and other is not None:
                    yield regime, setting, learned, other, compared(learned[1], other[1], f"{other[1].error}_rms")


def results_of(benchmark: Benchmark, experiment: Experiment[Label]) -> Results:
    """Results of an experiment that was played. Raises ValueError, OSError."""
    scores: dict[str, dict[tuple[str, str], list[Any]]] = {}
    for label in sorted(experiment.cells, key=lambda label: benchmark.settings.index(label.setting)):
        scores.setdefault(label.regime, {}).setdefault((label.policy, label.setting), []).append(experiment.scores(label))
    kinds = {entrant.label: next(iter(entrant.members(benchmark.task).values())) for entrant in benchmark.entrants}
    controllers = frozenset(name for name, policy in kinds.items() if isinstance(policy, Controller))
    return Results(benchmark, controllers, {regime: {key: Standing(own) for key, own in of.items()} for regime, of in scores.items()})
