"""Policies side by side in one recording: each has an arm, and all act through the same episodes at the same time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from soft_tendon_env import recording
from soft_tendon_env.evaluation import EpisodeScore, evaluate
from soft_tendon_env.evaluation.settings import Run, make_env
from soft_tendon_env.policies.load import load_policy, short_name


def arm_names(policies: Sequence[str]) -> list[str]:
    """Short names, unless two are the same."""
    short = [short_name(policy) for policy in policies]
    return short if len(set(short)) == len(short) else list(policies)


def record_side_by_side(runs: Sequence[Run], file: Any, names: Sequence[str], new: bool = True) -> list[list[EpisodeScore]]:
    """The scores of every run, whose episodes go to the arm of its name in an open RerunFile; `new`: which has none of them yet."""
    players = []
    for run, name in zip(runs, names, strict=True):
        env = make_env(run)
        place: Literal["beside"] | None = "beside" if new else None
        players.append((load_policy(run.policy, env), recording.RecordRollout(env, file, flush_period=None, name=name, place=place)))
    scores: list[list[EpisodeScore]] = [[] for _ in runs]
    with tqdm(total=len(runs) * len(runs[0].seeds), desc="side by side", unit="episode", leave=False) as bar:
        for seed in runs[0].seeds:
            file.align()
            for (policy, env), run, of_run in zip(players, runs, scores, strict=True):
                of_run += evaluate(policy, env, [seed], run.skip)
                bar.update()
    return scores


def opening_hint(path: Path) -> str:
    return f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with the extra `recording`)"
