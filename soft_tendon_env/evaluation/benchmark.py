"""Benchmark of policies on arms that none of them was made for.

The task, the information and the episodes are the same for all.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import groups_of
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.conditions import SEEDS, SETTINGS
from soft_tendon_env.evaluation.entrants import agents_of, trained_alike
from soft_tendon_env.evaluation.experiment import Cell, Experiment
from soft_tendon_env.evaluation.settings import (
    RegimeNames,
    SettingNames,
    TaskName,
    Workers,
    episode_steps,
)
from soft_tendon_env.evaluation.summaries import Mean, Standing, Standings, difference
from soft_tendon_env.evaluation.tables import (
    NUMBERS_LEGEND,
    number,
    number_tables,
    record_table,
)
from soft_tendon_env.policies.agent import IN_REPOSITORY, INTERFACE, lacks_seeds
from soft_tendon_env.policies.names import Agent, Controller, PolicyName, split_name
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import NotNegative, Positive

PLANT = "fine"
"""Fidelity of the arm that the benchmark is played on."""
TARGET = {"target": "random", "difficulty": "medium"}
"""Options of the target that all follow, but in the settings "easy" and "hard"."""
SIDES_LEGEND = (
    "- **Ahead, behind**: the 95 % interval of the paired difference leaves out zero. **Not"
    " separated**: it does not. The best of both kinds are chosen by the same episodes."
)
TOLD_LEGEND = (
    "- **Told**: the controller's model has the effects of the setting, in the middle of their"
    " ranges."
)


class BenchmarkPolicy(Configuration):
    """One policy of the benchmark.

    Attributes:
        policy: a controller with a state estimator, such as filtered:predictive or
            filtered:tracking@fast; the folder of an agent, or agent, ppo, sac, dagger or apg, of
            those that ship, or a folder of runs of `soft-tendon sweep`, each alone or behind
            filtered:; or `module:name`.
        name: in tables, by default `policy`.
        told: the model of a controller includes the effects of the setting, with the numbers of
            `Condition.scene`, not those that an episode draws: fluid at rest, no load where loads
            are drawn about zero.
    """

    policy: str
    name: str = Field(default_factory=lambda given: given.get("policy", ""), min_length=1)
    told: bool = False

    def members(self, task: str) -> dict[int | None, PolicyName]:
        """Policies of which it consists, by seed of training; None: the only one.

        Raises ValueError, OSError for what is none.
        """
        (files,) = agents_of(task, [self.policy]).values()
        if files.keys() == {None}:
            name = PolicyName.parse(self.policy, task)
            files = trained_alike(name)
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
        rate_limit: rate [N/s] at which the actuators let commands change at most, the same for all
            entrants; None: no limit, so that agents are held by their increments alone and
            controllers by nothing.
    """

    task: TaskName = "TipPose"
    scene: str = "paper"
    entrants: tuple[BenchmarkPolicy, ...] = Field(min_length=1)
    settings: SettingNames = tuple(SETTINGS)
    regimes: RegimeNames = tuple(REGIMES)
    episodes: int = Field(default=20, ge=1, le=len(SEEDS["arena"]))
    seconds: Positive = 6.0
    skip: NotNegative = 1.0
    rate_limit: Positive | None = None

    @property
    def actuators(self) -> str:
        """Sentence on the rate limit that all entrants have."""
        if self.rate_limit is None:
            return "Commands have no rate limit: agents are held by their own increments alone."
        return f"Commands of all entrants change by at most {self.rate_limit:g} N/s."

    @model_validator(mode="after")
    def _fits(self) -> "Benchmark":
        names = [entrant.name for entrant in self.entrants]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            text = f"has {twice[0]!r} several times: give each a name of its own"
            raise ConfigurationError([Problem(("entrants",), text)])
        episode_steps(self.seconds, self.skip, TARGET)
        return self

    def cells(self) -> tuple[dict[Label, Cell], list[str]]:
        """All that is to be played, and lines about policies that are left out.

        There is a line for every policy whose files are missing or for which no regime suffices,
        and one for those of which a wheel has one seed. Raises ValueError where nobody is left.
        """
        cells = dict[Label, Cell]()
        notes = list[str]()
        of_one_seed = list[str]()
        for entrant in self.entrants:
            try:
                cells |= dict(self._cells_of(entrant))
                _, agent, _ = split_name(entrant.policy)
                if lacks_seeds(agent, self.task):
                    of_one_seed.append(entrant.name)
            except (ValueError, OSError) as error:
                notes.append(f"{entrant.name} is left out: {error}")
        if not cells:
            raise ValueError(f"nobody can play: {'; '.join(notes)}")
        if of_one_seed:
            names = ", ".join(of_one_seed)
            notes.append(
                f"{names}: other seeds of the training are not in a wheel, {IN_REPOSITORY}"
            )
        return cells, notes

    def _cells_of(self, entrant: BenchmarkPolicy) -> Iterator[tuple[Label, Cell]]:
        """Labels and cells of a policy.

        Raises ValueError, OSError where it cannot play.
        """
        reasons = list[str]()
        plays = False
        members = entrant.members(self.task)
        per_member = self.episodes / len(members)
        share = math.ceil(per_member)
        for place, (seed, policy) in enumerate(members.items()):
            # the last seed of training takes the last episodes, even if others play them too
            last = self.episodes - share
            first = min(place * share, last)
            part = SEEDS["arena"][first : first + share]
            episodes = tuple(part)
            for regime in self.regimes:
                observed = interface_options(policy, regime)
                options = {"scene": self.scene, **observed}
                reason = misfit(policy, options, regime)
                if reason:
                    reasons.append(f"{regime}: {reason}")
                    continue
                plays = True
                nominal = {
                    **observed,
                    **TARGET,
                    "scene": self.scene,
                    "fidelity": PLANT,
                    "rate_limit": self.rate_limit,
                    "randomize": {"noise": dict(REGIMES[regime].noise)},
                }
                for setting in self.settings:
                    condition = SETTINGS[setting]
                    # the controller's model has the effects only where it is told of them
                    believed: dict[str, Any] = {"scene": self.scene}
                    if entrant.told:
                        believed |= condition.scene(load_scene(self.scene))
                    cell = Cell(
                        self.task,
                        policy.text,
                        condition.options(nominal),
                        episodes,
                        self.seconds,
                        self.skip,
                        controller_scene=believed,
                    )
                    label = Label(entrant.name, seed, regime, setting)
                    yield label, cell
        if reasons and not plays:
            every = "; ".join(dict.fromkeys(reasons))  # those of several seeds are alike
            raise ValueError(f"no regime has what it needs ({every})")


def interface_options(policy: PolicyName, regime: str) -> dict[str, Any]:
    """Options of an environment in which a policy observes what it needs within a regime.

    Users' policies, unless they say otherwise, observe all that the task has and the regime allows.
    Raises ValueError, OSError.
    """
    if isinstance(policy, Controller):
        # without an estimator a controller observes what it needs, whatever the regime
        own_regime = None if policy.estimator is None else regime
        return policy.options({}, own_regime)
    own = policy.options({})
    if isinstance(policy, Agent):
        return {key: value for key, value in own.items() if key in INTERFACE}
    allowed = REGIMES[regime]
    groups_of_task = TASKS[policy.task].observable
    observable = [name for name in allowed.groups if name in groups_of_task]
    sensors = allowed.sensors or ()
    return {"observation": observable, "sensors": sensors, **own}


def misfit(
    policy: PolicyName,
    options: Mapping[str, Any],
    regime: str,
) -> str:
    """Reason why a policy that observes what these options say cannot play in a regime; "": it can.

    Raises ValueError.
    """
    parsed = Options.parse(dict(options), "options")
    allowed = REGIMES[regime]
    if isinstance(policy, Agent):
        period = policy.arm["control_period"]
        if period != parsed.control_period:
            return f"it was trained with control_period = {period}"
    groups = groups_of(parsed, TASKS[policy.task])
    beyond = [name for name in groups if name not in allowed.allowed]
    if beyond:
        return f"it observes {', '.join(beyond)}"
    if isinstance(parsed.sensors, int):
        count = parsed.sensors
    else:
        count = len(parsed.sensors)
    if "strain" in groups and count > allowed.sensors:
        return f"it has {count} strain sensors"
    return ""


def standings_by_regime(
    benchmark: Benchmark, experiment: Experiment[Label]
) -> dict[str, Standings]:
    """Standings by policy and setting, of every regime, once the experiment was played.

    Raises ValueError, OSError.
    """
    standings = dict[str, dict[tuple[str, str], Standing]]()
    settings = benchmark.settings
    in_order = sorted(experiment.cells, key=lambda label: settings.index(label.setting))
    for label in in_order:
        of_regime = standings.setdefault(label.regime, {})
        member = experiment.scores(label)
        key = (label.policy, label.setting)
        if key in of_regime:
            before = of_regime[key].scores
        else:
            before = []
        every_member = [*before, member]
        of_regime[key] = Standing(every_member)
    return dict(standings)


def benchmark_tables(benchmark: Benchmark, by_regime: Mapping[str, Standings]) -> str:
    """Definitions, settings, and per regime who is ahead, tables of all numbers, and of gaps.

    A gap is that of the best learned policy to the best controller.
    """
    played = {name for standings in by_regime.values() for name, _ in standings}
    others = set[str]()
    kind = "learned policy"
    is_told = False
    for entrant in benchmark.entrants:
        if entrant.name not in played:
            continue
        members = entrant.members(benchmark.task).values()
        policy = next(iter(members))
        is_told = is_told or entrant.told
        if not isinstance(policy, Controller):
            others.add(entrant.name)
            if not isinstance(policy, Agent):
                kind = "other policy"  # nobody knows whether a policy of a user's has learned
    definitions = [NUMBERS_LEGEND, SIDES_LEGEND]
    if is_told:
        definitions.append(TOLD_LEGEND)
    settings = []
    for name in benchmark.settings:
        description = SETTINGS[name].description
        settings.append(f"- `{name}`: {description}.")
    texts = ["\n".join(definitions), "Settings:", "\n".join(settings)]
    for regime, standings in by_regime.items():
        text = _regime_text(regime, standings, others, kind)
        texts.append(text)
    return "\n\n".join(texts)


def _regime_text(regime: str, standings: Standings, others: set[str], kind: str) -> str:
    """Heading, verdict and tables of a regime.

    others: names of the policies that are no controllers; kind: what these are.
    """
    first = next(iter(standings.values()))
    by_label = dict[str, Mapping[str, Mean]]()
    columns = dict[str, dict[str, str]]()
    for name in first.episodes[0].errors:
        unit = error_unit(name)
        of_error = gaps(standings, others, f"{name}_rms")
        by_label[unit.label.removesuffix(" error")] = of_error
        columns[unit.heading] = _gap_cells(of_error, unit.factor)
    by_label["return"] = gaps(standings, others, "return")
    columns["loss of return"] = _gap_cells(by_label["return"], 1.0)

    title = REGIMES[regime].title
    description = REGIMES[regime].description.capitalize()
    parts = [f"### {title}", f"{description} (`{regime}`)."]
    parts += verdict(by_label, kind)
    parts += number_tables(standings)
    rows = []
    for setting in by_label["return"]:
        row = {f"best {kind} minus best controller": setting}
        setting_cells = {heading: cells[setting] for heading, cells in columns.items()}
        rows.append(row | setting_cells)
    if rows:
        parts.append(record_table(rows))
    return "\n\n".join(parts)


def _gap_cells(by_setting: Mapping[str, Mean], factor: float) -> dict[str, str]:
    """Gaps times a factor, with their intervals, by setting."""
    cells = dict[str, str]()
    for setting, mean in by_setting.items():
        value, low, high = (number(factor * end) for end in mean)
        cells[setting] = f"{value} ({low} to {high})"
    return cells


def gaps(
    standings: Standings,
    learned: set[str],
    key: str,
) -> dict[str, Mean]:
    """Gaps of the best learned policy to the best controller, by setting where both play.

    A gap says by how much the learned policy has more of an error, or less return.
    """
    if key == "return":
        sign = -1.0
    else:
        sign = 1.0
    by_setting = dict[str, Mean]()
    every_setting = (setting for _, setting in standings)
    for setting in dict.fromkeys(every_setting):
        agents = list[Standing]()
        controllers = list[Standing]()
        for (name, own_setting), standing in standings.items():
            if own_setting == setting:
                (agents if name in learned else controllers).append(standing)
        if agents and controllers:
            best_agent = _least(agents, key, sign)
            best_controller = _least(controllers, key, sign)
            mean = difference(best_agent, best_controller, key)
            first = sign * mean.low
            second = sign * mean.high
            low, high = sorted((first, second))
            value = sign * mean.value
            by_setting[setting] = Mean(value, low, high)
    return by_setting


def _least(
    standings: Sequence[Standing],
    key: str,
    sign: float,
) -> Standing:
    """The standing with the least mean of a number times a sign; NaN counts as the largest."""
    means = [sign * standing.mean(key).value for standing in standings]
    best = int(np.argsort(means, kind="stable")[0])
    return standings[best]


def verdict(apart: Mapping[str, Mapping[str, Mean]], kind: str = "learned policy") -> list[str]:
    """A sentence and a list that say, by every label, on which side of zero its gap lies.

    There are none without gaps. kind: of policies that are compared with controllers.
    """
    items = list[str]()
    for label, gap in apart.items():
        settings_by_side = dict[str, list[str]]()
        for setting, mean in gap.items():
            settings_by_side.setdefault(_side(mean), []).append(setting)
        parts = []
        for side, settings in sorted(settings_by_side.items()):
            if len(settings) == len(gap):
                where = "all"
            else:
                where = ", ".join(settings)
            parts.append(f"{side} in {where}")
        if parts:
            items.append(f"- By {label}: {'; '.join(parts)}.")
    if not items:
        return []
    return [f"The best {kind} beside the best controller:", "\n".join(items)]


def _side(gap: Mean) -> str:
    """Side of zero on which the whole interval of a gap lies."""
    if gap.high < 0.0:
        return "ahead"
    if gap.low > 0.0:
        return "behind"
    return "not separated"
