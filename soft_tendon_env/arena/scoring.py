"""Scores of the benchmark: what an episode of a policy is judged by, as plain numbers that are kept.

To add one, add it to `episode_record`, and to COLUMNS of page.py where it should be shown.
"""

import math
from typing import Any

import numpy as np

from soft_tendon_env.evaluation.conditions import Difficulty
from soft_tendon_env.evaluation.metrics import Episode, score


def episode_record(episode: Episode, difficulty: Difficulty, skip: float) -> dict[str, Any]:
    """An episode in numbers, SI units; errors count from `skip` [s] on, and are None where it diverged before its end.

    `NAME_rms` and `NAME_percentile_95` of every error, `settling_time` [s] (None: not settled), `chatter` [N], `effort` [N], `violations`
    (steps), `seconds` per action (median), `diverged` (its cause), `bad` (diverged, or off by more than the difficulty allows).
    """
    judged = score(episode, skip)
    ended = judged.diverged is not None
    numbers = {f"{name}_{kind}": value for name, of in judged.errors.items() for kind, value in of._asdict().items()}
    first = next(iter(judged.errors.values())).rms
    limit = math.inf if difficulty.bad is None else difficulty.bad * episode.length
    return {
        "seed": episode.seed,
        **{name: None if ended or not math.isfinite(value) else value for name, value in numbers.items()},
        "settling_time": judged.settling_time,
        "chatter": None if ended or math.isnan(judged.chatter) else judged.chatter,
        "effort": judged.effort,
        "violations": judged.bound_violations,
        "seconds": float(np.median(judged.action_seconds)) if judged.action_seconds else None,
        "diverged": judged.diverged,
        "bad": bool(ended or not first <= limit),
    }
