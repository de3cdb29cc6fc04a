"""Policies side by side in one recording: each has an arm, and all act through the same episodes at the same time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import gymnasium as gym
from tqdm import tqdm

from soft_tendon_env import recording
from soft_tendon_env.evaluation import EpisodeScore, evaluate
from soft_tendon_env.evaluation.settings import Run, make_env
from soft_tendon_env.policies.load import load_policy, short_name
from soft_tendon_env.policies.protocol import Policy


def arm_names(policies: Sequence[str]) -> list[str]:
    """Short names, unless two are the same."""
    short = [short_name(policy) for policy in policies]
    return short if len(set(short)) == len(short) else list(policies)


class Player(NamedTuple):
    """A policy, and its environment, of which a recording is made."""

    policy: Policy
    env: gym.Env[Any, Any]


def record_side_by_side(runs: Sequence[Run], file: Any, names: Sequence[str], new: bool = True) -> list[list[EpisodeScore]]:
    """The scores of every run, whose episodes go to the arm of its name in an open RerunFile; `new`: which has none of them yet."""
    players = []
    for run, name in zip(runs, names, strict=True):
        env = make_env(run)
        place: Literal["beside"] | None = "beside" if new else None
        players.append(Player(load_policy(run.policy, env), recording.RecordRollout(env, file, flush_period=None, name=name, place=place)))
    return record_players(players, file, runs[0].seeds, runs[0].skip)


def record_players(players: Sequence[Player], file: Any, seeds: Sequence[int], skip: float) -> list[list[EpisodeScore]]:
    """The scores of every player, which all act through the same episodes; errors count from `skip` [s] on."""
    scores: list[list[EpisodeScore]] = [[] for _ in players]
    with tqdm(total=len(players) * len(seeds), desc="side by side", unit="episode", leave=False) as bar:
        for seed in seeds:
            file.align()
            for (policy, env), of_player in zip(players, scores, strict=True):
                of_player += evaluate(policy, env, [seed], skip)
                bar.update()
    return scores


def opening_hint(path: Path) -> str:
    return f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with the extra `recording`)"
