"""Experiments: policies x conditions x seeds, as cells that are played once, kept in a file each, and so go on where they were stopped.

`evaluate`, `compare`, `demo` and `arena` are experiments. A cell's file is named after all that its result depends on: the arm and what is
believed of it, as resolved; observation and target; the policy and its files; the episodes; and the code. What changes is played again.
"""

import ast
import functools
import hashlib
import json
import operator
import sys
import sysconfig
import time
import warnings
from collections.abc import Callable, Hashable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import gymnasium as gym
import numpy as np

from soft_tendon_env.envs import IDS, Options
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.evaluation.entrants import believed_scene, fingerprint
from soft_tendon_env.evaluation.metrics import EpisodeScore, score
from soft_tendon_env.evaluation.play import play, play_steps
from soft_tendon_env.evaluation.provenance import machine, origin, write_json
from soft_tendon_env.evaluation.settings import episode_steps
from soft_tendon_env.policies.agent_checks import TrainingWarning
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.passive_fields import FieldsWarning
from soft_tendon_env.tools.files import PACKAGE, digest, read_json, replacing
from soft_tendon_env.tools.parallel import run_all

SHOWS_ALONE = (
    "arena/",
    "cli/",
    "demo/",
    "differentiable/",
    "drawing/",
    "export/",
    "identification/",
    "learning/",
    "paper/",
    "recording/",
    "robots/",
    "tuning/",
    "evaluation/summaries.",
    "evaluation/tables.",
    "evaluation/pages.",
    "evaluation/pictures.",
    "policies/trained_by.",
)
"""Parts of the package on which no result of an episode depends."""
SOURCES = (".py", ".toml", ".json", ".npz")
INSTALLED = {"site-packages", "dist-packages"}
PROBED, STEPS = 4, 10
"""Episodes side by side, and steps of each, from which the time of a cell is estimated."""
Label = TypeVar("Label", bound=Hashable)
Opened = tuple[Policy, Any]
"""A policy and its environment, single or vector."""


class Cell(NamedTuple):
    """Unit of work: a policy under a condition, over its episodes. Plain values, which other processes and machines can get.

    options: of the environment, the condition: arm, observation, target. seconds: length of an episode; errors count from `skip` [s] on.
    measured: scores of "episodes"; those with nothing beside them, for the "time" of an action of a single arm. rows: episodes
    are side by side, else one after another. told: option `scene` of the arm that controllers believe in, at BELIEF unless their name says
    another fidelity, while agents may have been trained with other effects; None: the environment's own model.
    """

    task: str
    policy: str
    options: Mapping[str, Any]
    seeds: tuple[int, ...]
    seconds: float
    skip: float
    measured: Literal["episodes", "time"] = "episodes"
    rows: bool = True
    told: Mapping[str, Any] | None = None

    def open(self) -> Opened:
        """The policy and its environment: a single one, or with a row per seed. Raises ConfigurationError, ValueError, OSError."""
        steps = episode_steps(self.seconds, self.skip, self.options)
        with warnings.catch_warnings():
            if self.told is not None:  # fields made for other loads are taken as they are: the page of the results says so
                warnings.simplefilter("ignore", FieldsWarning)
            if not self.rows:
                env: Any = gym.make(IDS[self.task], max_episode_steps=steps, **self.options)
            else:
                env = gym.make_vec(IDS[self.task], num_envs=len(self.seeds), threads=1, max_episode_steps=steps, **self.options)
        policy = PolicyName.parse(self.policy, self.task)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TrainingWarning)  # what the commands print says it once
            return policy.load(env, believed_scene(policy, self.told), other_effects=self.told is not None), env

    def key(self, code: str) -> str:
        """Digest of all that the result depends on, with the version of the code. Raises ConfigurationError, ValueError, OSError."""
        options, policy = Options.parse(self.options, "options"), PolicyName.parse(self.policy, self.task)
        believed = believed_scene(policy, self.told)
        scenes = [scene.model_dump(mode="json") for scene in (resolved_scene(options), believed) if scene is not None]
        content = {
            **self._asdict(),
            "options": options.model_dump(mode="json"),
            "policy": fingerprint(policy),
            "told": scenes,
            "files": {path: digest(Path(path)) for scene in scenes for path in _files_in(scene)},
            "code": code,
            "machine": machine() if self.measured == "time" else None,
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def _files_in(value: Any) -> Iterator[str]:
    """Paths of files that plain tables name."""
    if isinstance(value, Mapping | list):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from _files_in(inner)
    elif isinstance(value, str) and value and "\0" not in value and len(value) < 4096 and Path(value).is_file():
        yield value


def code_version() -> str:
    """Digest of the sources that results come from: the package's, and those of modules that are not installed, which may register tasks,
    controllers or metrics."""
    loaded = {Path(str(name)) for module in [*sys.modules.values()] if (name := getattr(module, "__file__", None))}
    known = PACKAGE, Path(sysconfig.get_path("stdlib")), Path(sysconfig.get_path("scripts"))  # and the program soft-tendon
    users = [path for path in loaded if not INSTALLED & {*path.parts} and not any(map(path.is_relative_to, known)) and path.is_file()]
    return hashlib.sha256("".join([package_version(), *sorted(map(source_digest, users))]).encode()).hexdigest()


@functools.cache
def package_version() -> str:
    """Digest of the sources of the package that results come from."""
    sources = {path.relative_to(PACKAGE).as_posix(): path for path in PACKAGE.rglob("*") if path.suffix in SOURCES}
    parts = [f"{name} {source_digest(path)}" for name, path in sorted(sources.items()) if not name.startswith(SHOWS_ALONE)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def source_digest(path: Path) -> str:
    """Digest of a file, of Python code without its docstrings: other words in them make no other results. Raises OSError."""
    if path.suffix != ".py":
        return digest(path)
    lines = path.read_bytes().split(b"\n")
    try:
        blocks: list[ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef] = [ast.parse(b"\n".join(lines))]
    except (SyntaxError, ValueError):
        return digest(path)
    found = list[ast.Expr]()
    for block in blocks:  # which grow
        blocks += [node for node in block.body if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)]
        found += [node for node in block.body if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)]
    for node in sorted(found, key=operator.attrgetter("lineno"), reverse=True):
        first, last = node.lineno - 1, node.end_lineno or node.lineno
        lines[first:last] = [lines[first][: node.col_offset] + lines[last - 1][node.end_col_offset :]]
    return hashlib.sha256(b"\n".join(lines)).hexdigest()


def measure(cell: Cell, opened: Opened | None = None) -> list[dict[str, Any]]:
    """Records of what is measured in a cell, one per seed, as they are kept. Raises ValueError, OSError.

    opened: see `Cell.open`, which is called by default.
    """
    policy, env = cell.open() if opened is None else opened
    try:
        together = [cell.seeds] if cell.rows else [(seed,) for seed in cell.seeds]
        return [score(episode, cell.skip).record() for seeds in together for episode in play(policy, env, seeds)]
    finally:
        env.close()


def episode_time(cell: Cell) -> float:
    """Estimate of the time [s] that an episode of a cell takes on a core of its own, without loading the policy: from the reset and the
    first steps of few."""
    count = min(len(cell.seeds), PROBED if cell.rows else 1)
    policy, env = cell._replace(seeds=cell.seeds[:count]).open()
    times = list[float]()
    try:
        for _ in range(2):  # what is compiled is compiled by the first
            steps = play_steps(policy, env, cell.seeds[:count])
            for _ in range(1 + STEPS):
                started = time.process_time()
                next(steps)
                times.append(time.process_time() - started)
    finally:
        env.close()
    reset, *own = times[1 + STEPS :]
    return (reset + episode_steps(cell.seconds, cell.skip, cell.options) * float(np.median(own))) / count


class Experiment(Generic[Label]):
    """Cells by their labels, and the folder that keeps their results.

    Cells that measure times are played first, in this process with nothing beside it. Raises ConfigurationError, ValueError, OSError.
    """

    def __init__(self, cells: Mapping[Label, Cell], folder: Path) -> None:
        code = code_version()
        self.cells, self._folder = cells, folder
        self._paths = {label: folder / f"{cell.key(code)}.json" for label, cell in cells.items()}
        self._opened: dict[Label, Opened] = {}

    def open_alone(self) -> None:
        """Load the policies of cells that measure times: what is wrong with one is said before anything takes long."""
        self._opened = {label: cell.open() for label, cell in self.cells.items() if cell.measured == "time"}

    def missing(self) -> list[Label]:
        """Labels of cells that have no result yet, one for all cells that are alike. Raises ValueError for a damaged result, OSError."""
        left = dict[Path, Label]()
        for label, path in self._paths.items():
            if not path.exists():
                left.setdefault(path, label)
            elif self.cells[label].measured not in read_json(path):
                raise ValueError(f"{path} is no result of an experiment: take it away, and it is played again")
        return [*left.values()]

    def played(self) -> "Experiment[Label]":
        """Experiment of the cells that have results alone."""
        return Experiment({label: cell for label, cell in self.cells.items() if self._paths[label].exists()}, self._folder)

    def estimate(self, workers: int, cluster: str | None = None, alike: Callable[[Label], Hashable] = lambda label: label) -> float:
        """Estimate of the time [s] that `play` takes, from the `episode_time` of one of all missing cells whose labels are alike. Raises as
        `play`."""
        episodes, first = dict[Hashable, int](), dict[Hashable, Cell]()
        for label in self.missing():
            first.setdefault(alike(label), self.cells[label])
            episodes[alike(label)] = episodes.get(alike(label), 0) + len(self.cells[label].seeds)
        times = run_all(episode_time, [*first.values()], workers, "estimate", unit="cell", cluster=cluster)
        return sum(map(operator.mul, times, episodes.values())) / workers

    def play(self, title: str, workers: int, cluster: str | None = None) -> None:
        """Play the cells that are missing, see `run_all`, and keep each result as soon as it is there. Raises as `measure`."""
        where, left = origin(), self.missing()
        self._folder.mkdir(parents=True, exist_ok=True)

        def keep(label: Label, records: list[dict[str, Any]]) -> None:
            cell = self.cells[label]
            with replacing(self._paths[label]) as path:
                write_json(path, {"cell": cell._asdict(), **where, cell.measured: records}, say=False)

        for label in left:
            if self.cells[label].measured == "time":
                keep(label, measure(self.cells[label], self._opened.pop(label, None)))
        others = [label for label in left if self.cells[label].measured != "time"]
        run_all(
            measure,
            [self.cells[label] for label in others],
            workers,
            title,
            unit="cell",
            cluster=cluster,
            done=lambda place, records: keep(others[place], records),
        )

    def result(self, label: Label) -> dict[str, Any]:
        """Content of a cell's file. Raises ValueError, OSError."""
        return read_json(self._paths[label])

    def scores(self, label: Label) -> list[EpisodeScore]:
        """Scores of a cell's episodes. Raises ValueError, OSError."""
        return [EpisodeScore.of_record(record) for record in self.result(label)[self.cells[label].measured]]
