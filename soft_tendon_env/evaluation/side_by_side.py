"""Policies side by side in one recording: each has an arm, and all act through the same episodes at the same time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from soft_tendon_env import recording
from soft_tendon_env.evaluation.experiment import Opened
from soft_tendon_env.evaluation.metrics import EpisodeScore
from soft_tendon_env.evaluation.play import evaluate
from soft_tendon_env.policies.load import short_name


def arm_names(policies: Sequence[str]) -> list[str]:
    """Short names of policies, unless two are the same."""
    short = [short_name(policy) for policy in policies]
    return short if len(set(short)) == len(short) else list(policies)


def record_side_by_side(
    players: Sequence[Opened], file: Any, names: Sequence[str], seeds: Sequence[int], skip: float, new: bool = True
) -> list[list[EpisodeScore]]:
    """Scores of every policy in its single environment, whose episodes go to the arm of its name in an open RerunFile.

    skip: errors count from then on [s]. new: the file has no episode of these arms yet.
    """
    place: Literal["beside"] | None = "beside" if new else None
    arms = [
        (policy, recording.RecordRollout(env, file, flush_period=None, name=name, place=place))
        for (policy, env), name in zip(players, names, strict=True)
    ]
    scores: list[list[EpisodeScore]] = [[] for _ in arms]
    with tqdm(total=len(arms) * len(seeds), desc="side by side", unit="episode", leave=False) as bar:
        for seed in seeds:
            file.align()
            for (policy, env), of_arm in zip(arms, scores, strict=True):
                of_arm += evaluate(policy, env, [seed], skip)
                bar.update()
    return scores


def opening_hint(path: Path) -> str:
    """Sentence that says how to play a recording."""
    return f"recording: {path}; where there is a screen, `rerun {path}` plays it (`rerun` comes with the extra `recording`)"
