"""Tuning: hyperparameter optimisation of trainings and controllers with Optuna (TPE sampler,
pruning, studies that machines share)."""
