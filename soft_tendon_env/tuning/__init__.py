"""Tuning: hyperparameter optimisation of trainings and controllers with Optuna.

It has the TPE sampler, pruning, and studies that machines share.
"""
