"""Protocol of the benchmark: who plays which conditions how often, as cells of an experiment."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

from pydantic import Field, model_validator

from soft_tendon_env.evaluation.conditions import DIFFICULTIES, NOMINAL, PLANT, SEEDS, SETTINGS
from soft_tendon_env.evaluation.entrants import interface_options, misfit, seed_files
from soft_tendon_env.evaluation.experiment import Cell
from soft_tendon_env.evaluation.settings import DifficultyName, DifficultyNames, RegimeNames, SettingNames, TaskName, Workers, episode_steps
from soft_tendon_env.policies.names import Controller, PolicyName, Seeds
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import NotNegative, Positive

ONLY = "policies may observe what does not depend on the discretisation of the arm, see REGIMES in policies/regimes.py"


class Entrant(Configuration):
    """One policy of the benchmark.

    Attributes:
        policy: a controller with a state estimator, such as filtered:predictive or adaptive:tracking@fast, see `load_policy`; the folder
            or .zip file of an agent, or agent, ppo, sac, dagger or apg, of those that ship; a folder of runs seed_0, seed_1, ..., as
            `soft-tendon sweep` leaves them; or `module:name`, see soft_tendon_env.policies.names.Own.
        seeds: a folder of runs that takes the place of `policy` if it exists.
        optional: leave the policy out, with a note, if its files are missing or no regime suffices for it; otherwise that is an error.
        name: in tables, by default `policy`.
        regimes: in which it is evaluated, by default all whose observations suffice for it.
        settings: in which it is evaluated, by default all.
        told: the model of a controller includes the effects of the setting, with the numbers of `Setting.scene`, not
            those that an episode draws: fluid at rest, no load where loads are drawn about zero. It shows how much of an error comes from
            an incomplete model.
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
    def plays(self) -> str:
        """Name of what plays: `seeds` where there is such a folder, else `policy`."""
        return self.policy if self.seeds is None or not Path(self.seeds).is_dir() else self.seeds

    def members(self, task: str) -> dict[int | None, PolicyName]:
        """Policies of which it consists, by seed of training; None: the only one. Raises ValueError, OSError for what is none, and for
        a policy without a model that should be told."""
        policy = PolicyName.parse(self.plays, task)
        if self.told and not isinstance(policy, Controller):
            raise ValueError(f"told is true of {self.plays}: it is for controllers, which have a model")
        files = seed_files(policy) if isinstance(policy, Seeds) else {None: self.plays}
        return {seed: PolicyName.parse(file, task) for seed, file in files.items()}


class Condition(NamedTuple):
    """Names of a condition in the tables of evaluation/conditions.py."""

    regime: str
    setting: str
    difficulty: str


class Label(NamedTuple):
    """Name of a cell: an entrant, its seed of training, and the condition."""

    entrant: str
    seed: int | None
    condition: Condition


class Protocol(Workers):
    """Entrants and conditions of the benchmark: the keys of a file such as configs/published.toml.

    Every method is evaluated in all settings at one difficulty, and in the nominal one at all, in every regime that suffices for it.

    Attributes:
        task: name of the task: TipPose, Shape, Reach, or one that was registered.
        scene: a shipped scene's name, or the path of a TOML file: the arm that every policy may know.
        entrants: tables of the methods that are compared, see soft_tendon_env.arena.protocol.Entrant.
        settings: names of model errors and loads, see soft_tendon_env.evaluation.conditions.
        regimes: names of sensor sets that policies observe, see soft_tendon_env.evaluation.conditions.
        difficulties: difficulties of the targets under which the nominal setting is evaluated.
        difficulty: difficulty of the targets under which all settings are evaluated.
        episodes: number of episodes of every method in every condition, on the first of the test seeds.
        episodes_per_seed: least number of these episodes that each training seed is evaluated on, in turn, so that the seeds together cover
            all; None: every seed is evaluated on all.
        seconds: length of an episode [s].
        skip: time at the beginning of an episode that errors leave out [s].
    """

    task: TaskName = "TipPose"
    scene: str = "paper"
    entrants: tuple[Entrant, ...] = Field(min_length=1)
    settings: SettingNames = tuple(SETTINGS)
    regimes: RegimeNames = tuple(REGIMES)
    difficulties: DifficultyNames = tuple(DIFFICULTIES)
    difficulty: DifficultyName = "medium"
    episodes: int = Field(default=20, ge=1, le=len(SEEDS["arena"]))
    episodes_per_seed: int | None = Field(default=None, ge=1)
    seconds: Positive = 6.0
    skip: NotNegative = 1.0

    @model_validator(mode="after")
    def _fits(self) -> "Protocol":
        labels = [entrant.label for entrant in self.entrants]
        if twice := [label for label in dict.fromkeys(labels) if labels.count(label) > 1]:
            text = f"has {twice[0]!r} several times: give each a name of its own"
            raise ConfigurationError([Problem(("entrants",), text)])
        episode_steps(self.seconds, self.skip, {})
        return self

    def present(self) -> tuple[Self, list[str]]:
        """The protocol without entrants of other regimes or settings and optional ones that cannot play, and a line for each of the latter
        and for everyone who plays without its seeds of training. Raises as `cells`, ValueError where nobody is left."""
        entrants, notes = list[Entrant](), list[str]()
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
            if entrant.seeds not in (None, entrant.plays):
                notes.append(f"{entrant.label} is a single training, {entrant.plays}: there is no folder {entrant.seeds} of several")
        if not entrants:
            raise ValueError(f"nobody can play: {'; '.join(notes) or 'all entrants are for other regimes or settings'}")
        return self.model_copy(update={"entrants": tuple(entrants)}), notes

    def cells(self) -> dict[Label, Cell]:
        """All that is to be played. Raises ValueError, OSError for entrants that cannot play, or cannot play anywhere."""
        return {label: cell for entrant in self.entrants for label, cell in self._cells_of(entrant)}

    def _cells_of(self, entrant: Entrant) -> Iterator[tuple[Label, Cell]]:
        chosen, reasons, plays = entrant.regimes or self.regimes, dict[str, None](), False
        members = entrant.members(self.task)
        own = max(self.episodes_per_seed or self.episodes, -(-self.episodes // len(members)))
        for place, (seed, policy) in enumerate(members.items()):
            episodes = tuple(SEEDS["arena"][(place * own + k) % self.episodes] for k in range(min(own, self.episodes)))
            for regime in (name for name in self.regimes if name in chosen):
                observed = interface_options(policy, regime)
                if reason := misfit(policy, {"scene": self.scene, **observed}, regime):
                    reasons[f"{regime}: {reason}"] = None
                    continue
                plays = True
                cell = partial(self._cell, entrant.told, policy.text, observed, episodes)
                for condition in self._conditions(regime, entrant.settings):
                    yield Label(entrant.label, seed, condition), cell(condition)
        if reasons and not plays:
            raise ValueError(f"{entrant.label} can play in no regime ({'; '.join(reasons)}): {ONLY}")

    def _conditions(self, regime: str, settings: tuple[str, ...]) -> list[Condition]:
        """Every setting and difficulty that is played in some of the settings; none: in all."""
        of_settings = [Condition(regime, setting, self.difficulty) for setting in self.settings]
        of_difficulties = [Condition(regime, NOMINAL, difficulty) for difficulty in self.difficulties]
        every = dict.fromkeys([*of_settings, *of_difficulties])
        return [condition for condition in every if not settings or condition.setting in settings]

    def _cell(self, told: bool, policy: str, observed: Mapping[str, Any], episodes: tuple[int, ...], condition: Condition) -> Cell:
        setting = SETTINGS[condition.setting]
        arm = {"scene": self.scene, **setting.scene(load_scene(self.scene))}
        options = {
            **observed,
            "scene": arm,
            "fidelity": PLANT,
            "target": dict(DIFFICULTIES[condition.difficulty].target),
            "randomize": {**setting.randomize, "noise": dict(REGIMES[condition.regime].noise)},
        }
        believed = arm if told else {"scene": self.scene}
        return Cell(self.task, policy, options, episodes, self.seconds, self.skip, told=believed)
