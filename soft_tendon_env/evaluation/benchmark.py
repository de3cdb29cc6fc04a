"""Benchmark of policies on arms that none of them was made for: the same task, information and
episodes for all."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import groups_of
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.conditions import SEEDS, SETTINGS
from soft_tendon_env.evaluation.entrants import agents_of, model_in_the_loop, trained_alike
from soft_tendon_env.evaluation.experiment import Cell, Experiment
from soft_tendon_env.evaluation.settings import (
    RegimeNames,
    SettingNames,
    TaskName,
    Workers,
    episode_steps,
)
from soft_tendon_env.evaluation.summaries import Mean, Standing, Standings, difference
from soft_tendon_env.evaluation.tables import ERRORS_LEGEND, error_table, number
from soft_tendon_env.policies.agent import INTERFACE, lacks_seeds
from soft_tendon_env.policies.names import Agent, Controller, PolicyName
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import NotNegative, Positive

PLANT = "fine"
"""Fidelity of the arm that the benchmark is played on."""
TARGET = {"target": "random", "difficulty": "medium"}
"""Options of the target that all follow, but in the settings "easy" and "hard"."""


class BenchmarkPolicy(Configuration):
    """One policy of the benchmark.

    Attributes:
        policy: a controller with a state estimator, such as filtered:predictive or
            adaptive:tracking@fast; the folder of an agent, or agent, ppo, sac, dagger or apg, of
            those that ship; a folder of runs of `soft-tendon sweep`; or `module:name`.
        name: in tables, by default `policy`.
        told: the model of a controller includes the effects of the setting, with the numbers of
            `Condition.scene`, not those that an episode draws: fluid at rest, no load where loads
            are drawn about zero.
    """

    policy: str
    name: str = Field(default_factory=lambda given: given.get("policy", ""), min_length=1)
    told: bool = False

    def members(self, task: str) -> dict[int | None, PolicyName]:
        """Policies of which it consists, by seed of training; None: the only one. Raises
        ValueError, OSError for what is none."""
        (files,) = agents_of(task, [self.policy]).values()
        if files.keys() == {None}:
            files = trained_alike(PolicyName.parse(self.policy, task))
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
        scene: a shipped scene's name, or the path of a TOML file: the arm that every policy may
            know.
        entrants: tables of the policies that are compared, see
            soft_tendon_env.evaluation.benchmark.BenchmarkPolicy.
        settings: names of model errors and loads, see soft_tendon_env.evaluation.conditions.
        regimes: names of sensor sets that policies observe, see soft_tendon_env.policies.regimes.
        episodes: number of episodes of every policy in every condition, on the first of the test
            seeds. The seeds of a training share them, as many to each: some are played by two where
            the number cannot be divided.
        seconds: length of an episode [s].
        skip: time at the beginning of an episode that errors leave out [s].
    """

    task: TaskName = "TipPose"
    scene: str = "paper"
    entrants: tuple[BenchmarkPolicy, ...] = Field(min_length=1)
    settings: SettingNames = tuple(SETTINGS)
    regimes: RegimeNames = tuple(REGIMES)
    episodes: int = Field(default=20, ge=1, le=len(SEEDS["arena"]))
    seconds: Positive = 6.0
    skip: NotNegative = 1.0

    @model_validator(mode="after")
    def _fits(self) -> "Benchmark":
        names = [entrant.name for entrant in self.entrants]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ConfigurationError(
                [
                    Problem(
                        ("entrants",),
                        f"has {twice[0]!r} several times: give each a name of its own",
                    )
                ]
            )
        episode_steps(self.seconds, self.skip, TARGET)
        return self

    def cells(self) -> tuple[dict[Label, Cell], list[str]]:
        """All that is to be played; and a line for every policy that is left out, since its files
        are missing or no regime suffices for it, and one for those of which a wheel has one seed.
        Raises ValueError where nobody is left."""
        cells, notes = dict[Label, Cell](), list[str]()
        of_one_seed = []
        for entrant in self.entrants:
            try:
                cells |= dict(self._cells_of(entrant))
                if lacks_seeds(entrant.policy, self.task):
                    of_one_seed.append(entrant.name)
            except (ValueError, OSError) as error:
                notes.append(f"{entrant.name} is left out: {error}")
        if not cells:
            raise ValueError(f"nobody can play: {'; '.join(notes)}")
        if of_one_seed:
            notes.append(
                f"{', '.join(of_one_seed)}: a wheel has one seed of the training, the others are in"
                " agents/trained of the repository; clone it and run the same command there"
            )
        return cells, notes

    def _cells_of(self, entrant: BenchmarkPolicy) -> Iterator[tuple[Label, Cell]]:
        reasons, plays, members = dict[str, None](), False, entrant.members(self.task)
        share = math.ceil(self.episodes / len(members))
        for place, (seed, policy) in enumerate(members.items()):
            first = min(place * share, self.episodes - share)
            episodes = tuple(SEEDS["arena"][first : first + share])
            for regime in self.regimes:
                observed = interface_options(policy, regime)
                if reason := misfit(policy, {"scene": self.scene, **observed}, regime):
                    reasons[f"{regime}: {reason}"] = None
                    continue
                plays, noise = True, {"noise": dict(REGIMES[regime].noise)}
                for setting in self.settings:
                    given = {
                        **observed,
                        **TARGET,
                        "scene": self.scene,
                        "fidelity": PLANT,
                        "randomize": noise,
                    }
                    believed = {
                        "scene": self.scene,
                        **(SETTINGS[setting].scene(load_scene(self.scene)) if entrant.told else {}),
                    }
                    options = SETTINGS[setting].options(given)
                    cell = Cell(
                        self.task,
                        policy.text,
                        options,
                        episodes,
                        self.seconds,
                        self.skip,
                        controller_scene=believed,
                    )
                    yield Label(entrant.name, seed, regime, setting), cell
        if reasons and not plays:
            only = "policies may observe what does not depend on the discretisation of the arm"
            raise ValueError(
                f"{entrant.name} can play in no regime ({'; '.join(reasons)}): {only}, see REGIMES"
                " in policies/regimes.py"
            )


def interface_options(policy: PolicyName, regime: str) -> dict[str, Any]:
    """Options of an environment in which a policy observes what it needs within a regime; users'
    policies, unless they say otherwise, all that the task has and the regime allows. Raises
    ValueError, OSError."""
    if isinstance(policy, Controller):
        return policy.options({}, None if policy.estimator is None else regime)
    if isinstance(policy, Agent):
        return {key: value for key, value in policy.options({}).items() if key in INTERFACE}
    allowed = REGIMES[regime]
    observable = [name for name in allowed.groups if name in TASKS[policy.task].observable]
    return {"observation": observable, "sensors": allowed.sensors or (), **policy.options({})}


def misfit(policy: PolicyName, options: Mapping[str, Any], regime: str) -> str:
    """Reason why a policy that observes what these options say cannot play in a regime; "": it can.
    Raises ValueError."""
    parsed, allowed = Options.parse(dict(options), "options"), REGIMES[regime]
    if (
        isinstance(policy, Agent)
        and (period := policy.arm["control_period"]) != parsed.control_period
    ):
        return f"it was trained with control_period = {period}"
    groups = groups_of(parsed, TASKS[policy.task])
    if beyond := [name for name in groups if name not in allowed.groups]:
        return f"it observes {', '.join(beyond)}"
    count = parsed.sensors if isinstance(parsed.sensors, int) else len(parsed.sensors)
    return (
        f"it has {count} strain sensors" if "strain" in groups and count > allowed.sensors else ""
    )


def standings_by_regime(
    benchmark: Benchmark, experiment: Experiment[Label]
) -> dict[str, Standings]:
    """Standings by policy and setting, of every regime, once the experiment was played. Raises
    ValueError, OSError."""
    scores: dict[str, dict[tuple[str, str], list[Any]]] = {}
    for label in sorted(
        experiment.cells, key=lambda label: benchmark.settings.index(label.setting)
    ):
        scores.setdefault(label.regime, {}).setdefault((label.policy, label.setting), []).append(
            experiment.scores(label)
        )
    return {
        regime: {key: Standing(members) for key, members in of.items()}
        for regime, of in scores.items()
    }


def benchmark_tables(benchmark: Benchmark, found: Mapping[str, Standings]) -> str:
    """A table per regime: errors by policy and setting, the gap of the best learned to the best
    controller, and who is ahead."""
    played = {name for of in found.values() for name, _ in of}
    players = [entrant for entrant in benchmark.entrants if entrant.name in played]
    first = {
        entrant.name: (next(iter(entrant.members(benchmark.task).values())), entrant.told)
        for entrant in players
    }
    models = {label: model_in_the_loop(*policy) for label, policy in first.items()}
    learned, texts = (
        {label for label, (policy, _) in first.items() if not isinstance(policy, Controller)},
        list[str](),
    )
    for regime, of in found.items():
        errors = {
            error_unit(name).label.removesuffix(" error"): f"{name}_rms"
            for name in next(iter(of.values())).episodes[0].errors
        }
        apart = {
            label: gaps(of, learned, key) for label, key in {**errors, "return": "return"}.items()
        }
        factor, gap = error_unit(next(iter(of.values())).error).factor, next(iter(apart.values()))
        row = {
            setting: "{} ({} to {})".format(*(number(factor * value) for value in mean))
            for setting, mean in gap.items()
        }
        below = [{"": "best learned minus best controller", **row}] if gap else []
        description = f"{REGIMES[regime].description.capitalize()}.{verdict(apart)}"
        texts.append(f"### {regime}\n\n{description}\n\n{error_table(of, models, below)}")
    return "\n\n".join([*texts, ERRORS_LEGEND])


def gaps(of: Standings, learned: set[str], key: str) -> dict[str, Mean]:
    """By how much the best learned policy has more of an error, or less return, than the best
    controller, by setting where both play."""
    found, sign = dict[str, Mean](), -1.0 if key == "return" else 1.0
    for setting in dict.fromkeys(setting for _, setting in of):
        kinds = [
            [
                standing
                for (name, at), standing in of.items()
                if at == setting and (name in learned) == kind
            ]
            for kind in (True, False)
        ]
        if all(kinds):
            means = [[sign * standing.mean(key).value for standing in kind] for kind in kinds]
            one, other = (
                kind[int(np.argsort(of_kind, kind="stable")[0])]
                for kind, of_kind in zip(kinds, means, strict=True)
            )  # NaN last
            value, *ends = (sign * end for end in difference(one, other, key))
            found[setting] = Mean(value, *sorted(ends))
    return found


def verdict(apart: Mapping[str, Mapping[str, Mean]]) -> str:
    """Sentences that say, by every label, where the interval of its gap leaves out zero, and on
    which side; none without gaps."""
    texts = list[str]()
    for label, gap in apart.items():
        sides = {
            setting: "ahead" if mean.high < 0.0 else "behind" if mean.low > 0.0 else "not separated"
            for setting, mean in gap.items()
        }
        named = {
            side: [setting for setting in gap if sides[setting] == side]
            for side in sorted({*sides.values()})
        }
        said = "; ".join(
            f"{side} in {', '.join(of) if len(of) < len(gap) else 'all'}"
            for side, of in named.items()
        )
        texts += [f" By {label}: {said}."] if said else []
    return "".join(
        [" The best learned policy against the best controller.", *texts] if texts else []
    )
