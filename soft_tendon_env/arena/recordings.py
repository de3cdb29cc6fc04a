"""Recordings of the benchmark: the best policies of every kind side by side under a condition, for the Rerun viewer."""

from pathlib import Path

import gymnasium as gym

from soft_tendon_env import recording
from soft_tendon_env.arena.entrants import make_entrant
from soft_tendon_env.arena.page import Played, duels
from soft_tendon_env.arena.play import fields_unchecked
from soft_tendon_env.arena.protocol import Cell, plant_options, told_scene
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation.settings import episode_steps
from soft_tendon_env.evaluation.side_by_side import Player, record_players


def record_duels(found: Played, cells: list[Cell], folder: Path) -> list[Path]:
    """A file REGIME_SETTING_DIFFICULTY.rrd for every condition in which the best learned and the best model-based policy meet: the first
    episode of both. Raises OSError."""
    written = []
    for condition, *names, _ in duels(found):
        path = folder / f"{'_'.join(condition)}.rrd"
        chosen = [
            next(cell for cell in cells if cell[:1] == ("episodes",) and cell.entrant == name and cell.condition == condition)
            for name in names
        ]
        with recording.RerunFile(path) as file:
            record_players([_player(cell, file) for cell in chosen], file, chosen[0].seeds[:1], chosen[0].skip)
        written.append(path)
    return written


def _player(cell: Cell, file: "recording.RerunFile") -> Player:
    options = plant_options(cell)
    with fields_unchecked():
        env = gym.make(IDS[cell.task], max_episode_steps=episode_steps(cell.seconds, cell.skip, options), **options)
    policy = make_entrant(cell.member, env, told_scene(cell))
    return Player(policy, recording.RecordRollout(env, file, flush_period=None, name=cell.entrant.replace(":", " "), place="beside"))
