"""Evaluation of policies on fixed lists of episodes, with summaries.

Tracking errors, settling times and effort are measured.
"""

from soft_tendon_env.evaluation.conditions import (
    EVALUATION_SEEDS,
    MODEL_ERRORS,
    SEEDS,
    VALIDATION_SEEDS,
    Condition,
    model_error,
)
from soft_tendon_env.evaluation.metrics import METRICS, EpisodeScore, Metric
from soft_tendon_env.evaluation.play import evaluate, evaluate_rows
from soft_tendon_env.evaluation.summaries import Summary, summarise

__all__ = [
    "EVALUATION_SEEDS",
    "METRICS",
    "MODEL_ERRORS",
    "SEEDS",
    "VALIDATION_SEEDS",
    "Condition",
    "EpisodeScore",
    "Metric",
    "Summary",
]
__all__ += ["evaluate", "evaluate_rows", "model_error", "summarise"]
