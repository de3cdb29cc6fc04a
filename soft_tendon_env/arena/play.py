"""Playing the cells of the benchmark in several processes; every result is a file of its own, so that a run that was stopped goes on."""

import os
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import gymnasium as gym
from tqdm import tqdm

from soft_tendon_env.arena.entrants import make_entrant
from soft_tendon_env.arena.margins import SETTLING, WATCHED, loop_margins
from soft_tendon_env.arena.protocol import Cell, plant_options, told_scene
from soft_tendon_env.arena.scoring import episode_record
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.vector import TendonRodVectorEnv
from soft_tendon_env.evaluation.conditions import DIFFICULTIES, PLANT
from soft_tendon_env.evaluation.play import play as play_episodes
from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.evaluation.settings import episode_steps
from soft_tendon_env.scene.passive_fields import FieldsWarning
from soft_tendon_env.tools.files import read_json, replacing


@contextmanager
def fields_unchecked() -> Iterator[None]:
    """Passive fields that were made for other loads are taken without a warning: docs/arena.md says so of all plants."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FieldsWarning)
        yield


def make_plant(cell: Cell, rows: int) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Rows of the environment of a cell, on one thread. Raises ValueError, OSError."""
    options = plant_options(cell)
    seconds = cell.seconds if cell.kind == "episodes" else SETTLING + WATCHED
    with fields_unchecked():
        return gym.make_vec(IDS[cell.task], num_envs=rows, threads=1, max_episode_steps=episode_steps(seconds, 0.0, options), **options)


def play(cell: Cell) -> dict[str, Any]:
    """The result of a cell, as it is kept. Raises ValueError, OSError."""
    scene, started = told_scene(cell), time.perf_counter()
    if cell.kind == "margins":
        envs = make_plant(cell, 1 + len(scene.tendons))
        inner = envs.unwrapped
        assert isinstance(inner, TendonRodVectorEnv)
        policy = make_entrant(cell.member, envs, scene)
        found: Any = [loop_margins(policy, inner, seed)._asdict() for seed in cell.seeds]
    else:
        envs = make_plant(cell, len(cell.seeds))
        policy, difficulty = make_entrant(cell.member, envs, scene), DIFFICULTIES[cell.difficulty]
        found = [episode_record(episode, difficulty, cell.skip) for episode in play_episodes(policy, envs, cell.seeds)]
    envs.close()
    return {"cell": cell._asdict(), "plant": PLANT, **origin(), "took": time.perf_counter() - started, cell.kind: found}


def result_path(cell: Cell, folder: Path) -> Path:
    """The file of a cell's result. Raises OSError."""
    return folder / f"{cell.key}.json"


def missing_cells(cells: Iterable[Cell], folder: Path) -> list[Cell]:
    """Those that have no result yet. Raises ValueError for a damaged one, OSError."""
    left = []
    for cell in cells:
        path = result_path(cell, folder)
        if not path.exists():
            left.append(cell)
        elif cell.kind not in read_json(path):
            raise ValueError(f"{path} is no result of the benchmark: take it away, and it is played again")
    return left


def play_and_keep(cell: Cell, folder: Path) -> Cell:
    """Play a cell and write its result."""
    with replacing(result_path(cell, folder)) as path:
        write_json(path, play(cell), say=False)
    return cell


def play_all(cells: Sequence[Cell], folder: Path, workers: int) -> None:
    """Play cells, in several processes if there are several, and keep each result as soon as it is there. Raises as `play`."""
    bar = tqdm(total=len(cells), desc="arena", unit="cell", leave=False)
    if workers == 1 or len(cells) <= 1:
        for cell in cells:
            bar.set_postfix_str(f"{cell.entrant}, {cell.setting}, {cell.regime}")
            play_and_keep(cell, folder)
            bar.update()
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of the workers: they are as many as there are cores
    with ProcessPoolExecutor(min(workers, len(cells)), get_context("spawn")) as pool:
        for future in as_completed([pool.submit(play_and_keep, cell, folder) for cell in cells]):
            done = future.result()
            bar.set_postfix_str(f"{done.entrant}, {done.setting}, {done.regime}")
            bar.update()


def read_result(cell: Cell, folder: Path) -> dict[str, Any]:
    """What was kept of a cell. Raises ValueError, OSError."""
    return read_json(result_path(cell, folder))
