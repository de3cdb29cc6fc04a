"""Protocol of the benchmark: who plays which conditions how often, as cells that are played once and kept."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from pydantic import Field, field_validator, model_validator

from soft_tendon_env.arena.entrants import Entrant, fingerprint, interface_options, misfit
from soft_tendon_env.evaluation.conditions import DIFFICULTIES, NOMINAL, PLANT, REGIMES, SETTINGS
from soft_tendon_env.evaluation.seeds import SEEDS
from soft_tendon_env.evaluation.settings import TaskName, episode_steps
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, plain
from soft_tendon_env.tools.types import NotNegative, Positive


class Protocol(Configuration):
    """What is played: the keys of a file such as configs/arena.toml.

    Every entrant plays all settings at one difficulty, and the nominal one at all difficulties, in every regime that suffices for it.

    Attributes:
        task: TipPose, Reach, Shape, or one that was registered.
        scene: a shipped scene's name, or the path of a TOML file: what everybody is told of the arm.
        entrants: tables of who plays, see soft_tendon_env.arena.entrants.Entrant.
        settings: how the arm may differ from every model, by the names in soft_tendon_env.evaluation.conditions.
        regimes: what policies are told, by the names in soft_tendon_env.evaluation.conditions.
        difficulties: of the targets, at which the nominal setting is played.
        difficulty: of the targets, at which all settings are played.
        episodes: how many every entrant plays in every condition, on the first of the test seeds.
        seconds: length of an episode [s].
        skip: time at the beginning of an episode that errors leave out [s].
        margins: measure delay and gain margins, a minute or so for every entrant and regime.
        workers: processes.
    """

    task: TaskName = "TipPose"
    scene: str = "paper"
    entrants: tuple[Entrant, ...] = Field(min_length=1)
    settings: tuple[str, ...] = tuple(SETTINGS)
    regimes: tuple[str, ...] = tuple(REGIMES)
    difficulties: tuple[str, ...] = tuple(DIFFICULTIES)
    difficulty: str = "medium"
    episodes: int = Field(default=20, ge=1, le=len(SEEDS["arena"]))
    seconds: Positive = 6.0
    skip: NotNegative = 1.0
    margins: bool = True
    workers: int = Field(default=2, ge=1)

    @field_validator("settings", "regimes", "difficulties")
    @classmethod
    def _known(cls, names: tuple[str, ...], info: Any) -> tuple[str, ...]:
        valid = {"settings": [*SETTINGS], "regimes": [*REGIMES], "difficulties": [*DIFFICULTIES]}[info.field_name]
        for name in names:
            if name not in valid:
                raise ValueError(f"names {name!r}: {not_among(name, valid)}")
        return tuple(dict.fromkeys(names))

    @field_validator("difficulty")
    @classmethod
    def _known_difficulty(cls, name: str) -> str:
        if name not in DIFFICULTIES:
            raise ValueError(f"is {name!r}: {not_among(name, DIFFICULTIES)}")
        return name

    @model_validator(mode="after")
    def _fits(self) -> "Protocol":
        labels = [entrant.label for entrant in self.entrants]
        if twice := [label for label in dict.fromkeys(labels) if labels.count(label) > 1]:
            text = f"has {twice[0]!r} several times: give each a name of its own"
            raise ConfigurationError([Problem(("entrants",), text)])
        for i, entrant in enumerate(self.entrants):
            for regime in entrant.regimes:
                if regime not in REGIMES:
                    raise ConfigurationError([Problem(("entrants", i, "regimes"), f"names {regime!r}: {not_among(regime, REGIMES)}")])
        episode_steps(self.seconds, self.skip, {})
        return self

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of the episodes."""
        return tuple(SEEDS["arena"][: self.episodes])

    @property
    def conditions(self) -> list[tuple[str, str]]:
        """Every setting and difficulty that is played."""
        of_settings = [(setting, self.difficulty) for setting in self.settings]
        of_difficulties = [(NOMINAL, difficulty) for difficulty in self.difficulties]
        return list(dict.fromkeys([*of_settings, *of_difficulties]))


class Cell(NamedTuple):
    """One policy under one condition, over all episodes. Plain values: worker processes get it.

    kind: "episodes", or "margins" of the loop that it closes.
    """

    kind: str
    task: str
    scene: str
    entrant: str
    member: str
    seed: int | None  # of training
    setting: str
    difficulty: str
    regime: str
    seeds: tuple[int, ...]
    seconds: float
    skip: float
    told: bool  # of the effects of the setting

    @property
    def condition(self) -> tuple[str, str, str]:
        """Regime, setting and difficulty."""
        return self.regime, self.setting, self.difficulty

    @property
    def key(self) -> str:
        """Digest of all that the result depends on but the code: plant, episodes, and the policy with its files. Raises OSError."""
        content = {
            "kind": self.kind,
            "task": self.task,
            "plant": plain(plant_options(self)),
            "scene": told_scene(self).model_dump(mode="json"),
            "seeds": self.seeds,
            "times": (self.seconds, self.skip),
            "policy": fingerprint(self.member, self.task),
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def cells(protocol: Protocol) -> Iterator[Cell]:
    """All that is to be played. Raises ValueError, OSError for entrants that cannot play, or cannot play anywhere."""
    for entrant in protocol.entrants:
        chosen = entrant.regimes or protocol.regimes
        reasons = []
        for seed, member in entrant.members(protocol.task).items():
            for regime in (name for name in protocol.regimes if name in chosen):
                observed = interface_options(member, protocol.task, REGIMES[regime])
                if reason := misfit(member, {"scene": protocol.scene, **observed}, protocol.task, REGIMES[regime]):
                    reasons.append(f"{regime}: {reason}")
                    continue
                common = protocol.task, protocol.scene, entrant.label, member, seed
                others = protocol.seconds, protocol.skip, entrant.told
                for setting, difficulty in protocol.conditions:
                    yield Cell("episodes", *common, setting, difficulty, regime, protocol.seeds, *others)
                if protocol.margins:
                    yield Cell("margins", *common, NOMINAL, protocol.difficulty, regime, protocol.seeds[:MARGIN_POSES], *others)
        if len(reasons) == len(entrant.members(protocol.task)) * len([name for name in protocol.regimes if name in chosen]):
            raise ValueError(f"{entrant.label} can play in no regime ({'; '.join(dict.fromkeys(reasons))}): {ONLY}")


ONLY = "policies may observe what does not depend on the discretisation of the arm, see `soft_tendon_env.evaluation.conditions.REGIMES`"
MARGIN_POSES = 2
"""Poses about which the loop is linearised."""


def told_scene(cell: Cell) -> Scene:
    """The arm that controllers believe in. Raises ValueError, OSError."""
    scene = load_scene(cell.scene)
    return scene.replace(SETTINGS[cell.setting].scene(scene)) if cell.told else scene


def plant_options(cell: Cell) -> dict[str, Any]:
    """Options of the environment of a cell. Raises ValueError, OSError."""
    regime, setting = REGIMES[cell.regime], SETTINGS[cell.setting]
    told = load_scene(cell.scene)
    margins = cell.kind == "margins"
    target: Mapping[str, Any] = {"type": "hold"} if margins else DIFFICULTIES[cell.difficulty].target
    return {
        **interface_options(cell.member, cell.task, regime),
        "scene": {"scene": cell.scene, **setting.scene(told)},
        "fidelity": PLANT,
        "target": dict(target),
        "randomize": {**setting.randomize, **({} if margins else {"noise": dict(regime.noise)})},
    }
