"""Experiments: policies x conditions x seeds, as cells that are played once.

Each is kept in a file, so that an experiment goes on where it was stopped.

A cell's file is named after a digest of the cell, its scenes, the policy's files, and the sources:
what changes is played again.
"""

import hashlib
import json
import sys
import sysconfig
import warnings
from collections.abc import Hashable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import gymnasium as gym

from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.envs import IDS, Options
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.evaluation.metrics import EpisodeScore, record, score, score_from
from soft_tendon_env.evaluation.play import play
from soft_tendon_env.evaluation.provenance import machine, origin
from soft_tendon_env.evaluation.settings import episode_steps
from soft_tendon_env.policies.agent import TrainingWarning
from soft_tendon_env.policies.names import Agent, Controller, PolicyName, UserPolicy
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.files import PACKAGE, digest, read_json, replacing, sources_digest
from soft_tendon_env.tools.parallel import run_all

BELIEF = "standard"
"""Fidelity of the model that controllers are told of, unless their name says another, as in
filtered:predictive@fast."""
FOLDERS = ("stdlib", "purelib", "platlib", "scripts")  # of Python, where modules are installed
Label = TypeVar("Label", bound=Hashable)


class Cell(NamedTuple):
    """Unit of work: a policy under a condition, over its episodes.

    Plain values, which other processes and machines can get.

    options: of the environment. seconds: length of an episode; errors count from `skip` [s] on.
    alone: played with nothing beside it, for times per action. rows: episodes are side by side,
    else one after another. controller_scene: option `scene` of the arm that controllers believe in,
    while agents may have been trained with other effects; None: the environment's own model.
    """

    task: str
    policy: str
    options: Mapping[str, Any]
    seeds: tuple[int, ...]
    seconds: float
    skip: float
    alone: bool = False
    rows: bool = True
    controller_scene: Mapping[str, Any] | None = None

    def open(self) -> tuple[Policy, Any]:
        """The policy and its environment: a single one, or with a row per seed.

        Raises ConfigurationError, ValueError, OSError.
        """
        steps = episode_steps(self.seconds, self.skip, self.options)
        options: dict[str, Any] = {"max_episode_steps": steps, **self.options}
        name = PolicyName.parse(self.policy, self.task)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TrainingWarning)  # what the commands print says it once
            env: Any
            if self.rows:
                count = len(self.seeds)
                env = gym.make_vec(IDS[self.task], num_envs=count, threads=1, **options)
            else:
                env = gym.make(IDS[self.task], **options)
            scene = believed_scene(name, self.controller_scene)
            has_other_effects = self.controller_scene is not None
            loaded = name.load(env, scene, other_effects=has_other_effects)
            return loaded, env

    def key(self, code: str) -> str:
        """Digest of all that the result depends on, with the sources' `code`.

        Raises ConfigurationError, ValueError, OSError.
        """
        options = Options.parse(self.options, "options")
        policy = PolicyName.parse(self.policy, self.task)
        believed = believed_scene(policy, self.controller_scene)
        both = resolved_scene(options), believed
        scenes = [scene.model_dump(mode="json") for scene in both if scene is not None]
        known = {
            "policy": policy.fingerprint(),
            "files": {path: digest(Path(path)) for path in _files_in(scenes)},
            "code": code,
        }
        known |= {
            "options": options.model_dump(mode="json"),
            "controller_scene": scenes,
            "machine": self.alone and machine(),
        }
        content = {**self._asdict(), **known}
        written = json.dumps(content, sort_keys=True).encode()
        return hashlib.sha256(written).hexdigest()[:24]


def believed_scene(
    policy: Controller | Agent | UserPolicy, controller_scene: Mapping[str, Any] | None
) -> Scene | None:
    """Scene of the model that a controller, a state estimator or a user's policy assumes.

    It is at BELIEF unless its name says a fidelity; None for agents alone, and without the option
    `scene` of such an arm. Raises ValueError.
    """
    is_agent_alone = isinstance(policy, Agent) and policy.estimator is None
    if controller_scene is None or is_agent_alone:
        return None
    options = Options(scene=dict(controller_scene), fidelity="scene")
    scene = resolved_scene(options)
    if not isinstance(policy, UserPolicy) and policy.belief:
        return scene
    return at_fidelity(scene, BELIEF)


def _files_in(value: Any) -> Iterator[str]:
    """Paths of files that plain tables name."""
    if isinstance(value, Mapping | list):
        parts: Iterable[Any] = value
        if isinstance(value, Mapping):
            parts = value.values()
        for inner in parts:
            yield from _files_in(inner)
    elif isinstance(value, str) and value and Path(value).is_file():
        yield value


def code_digest() -> str:
    """Digest of the package's sources, and of loaded modules that are not installed.

    These may register controllers or metrics.
    """
    installed = [Path(sysconfig.get_path(name)) for name in FOLDERS]
    own = sources_digest("**/*.py", "**/*.toml", "**/*.json", "**/*.npz")
    paths = set[Path]()
    for module in list(sys.modules.values()):  # which some modules change when they are looked at
        file = getattr(module, "__file__", None)
        if file:
            paths.add(Path(str(file)))
    users = []
    for path in paths:
        folders = (PACKAGE, *installed)
        is_known = any(map(path.is_relative_to, folders))
        if not is_known and path.is_file():
            users.append(digest(path))
    return " ".join([own, *sorted(users)])


def measure(cell: Cell) -> list[EpisodeScore]:
    """Scores of a cell, one per seed.

    Raises ValueError, OSError.
    """
    policy, env = cell.open()
    try:
        if cell.rows:
            together = [cell.seeds]
        else:
            together = [(seed,) for seed in cell.seeds]
        return [
            score(episode, cell.skip) for seeds in together for episode in play(policy, env, seeds)
        ]
    finally:
        env.close()


class Experiment(Generic[Label]):
    """Cells by their labels, and the folder that keeps their results.

    Cells that are played alone come first, in this process. Raises ConfigurationError, ValueError,
    OSError.
    """

    def __init__(self, cells: Mapping[Label, Cell], folder: Path) -> None:
        """Opens the cells that are played alone.

        An error of a policy is then raised before anything takes long.
        """
        code = code_digest()
        self.cells = cells
        self._folder = folder
        self._paths = {}
        for label, cell in cells.items():
            key = cell.key(code)
            self._paths[label] = folder / f"{key}.json"
        for cell in cells.values():
            if cell.alone:
                _, env = cell.open()
                env.close()

    def missing(self) -> list[Label]:
        """Labels of cells that have no result yet, one for all cells that are alike."""
        missing = dict[Path, Label]()
        for label, path in self._paths.items():
            if path not in missing and not path.exists():
                missing[path] = label
        return list(missing.values())

    def play(
        self,
        title: str,
        workers: int,
        cluster: str | None = None,
    ) -> None:
        """Plays the cells that are missing, and keeps each result when it has come.

        See `run_all`. The title begins the names of the progress bars. Raises as `measure`.
        """
        where = origin()
        left = self.missing()
        self._folder.mkdir(parents=True, exist_ok=True)

        def keep(
            labels: list[Label],
            place: int,
            scores: list[EpisodeScore],
        ) -> None:
            label = labels[place]
            content = {
                "cell": self.cells[label]._asdict(),
                **where,
                "scores": list(map(record, scores)),
            }
            with replacing(self._paths[label]) as path:
                # NaN and infinity stand in the file, as json has them
                path.write_text(json.dumps(content))

        # times per action are those of this process with nothing beside it
        for alone, part, processes, address in (
            (True, "times per action", 1, None),
            (False, "episodes", workers, cluster),
        ):
            labels = [label for label in left if self.cells[label].alone == alone]
            run_all(
                measure,
                [self.cells[label] for label in labels],
                processes,
                f"{title}: {part}",
                unit="cell",
                cluster=address,
                done=partial(keep, labels),
            )

    def scores(self, label: Label) -> list[EpisodeScore]:
        """Scores of a cell's episodes.

        Raises ValueError for a damaged result, OSError.
        """
        path = self._paths[label]
        try:
            scores = read_json(path)["scores"]
            return list(map(score_from, scores))
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"{path} is no result of an experiment: take it away, and it is played again"
            ) from error
