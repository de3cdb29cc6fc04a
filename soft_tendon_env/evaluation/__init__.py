"""Evaluation of policies on fixed lists of episodes: tracking errors, settling times, effort, and their summaries."""

from soft_tendon_env.evaluation.run import EVALUATION_SEEDS, MODEL_ERRORS, VALIDATION_SEEDS, evaluate, evaluate_rows, model_error
from soft_tendon_env.evaluation.scores import EpisodeScore, Summary, summarise

__all__ = [
    "EVALUATION_SEEDS",
    "MODEL_ERRORS",
    "VALIDATION_SEEDS",
    "EpisodeScore",
    "Summary",
    "evaluate",
    "evaluate_rows",
    "model_error",
    "summarise",
]
