"""Reinforcement learning with Stable-Baselines3: trainings, sweeps over seeds, learning curves, and
its vector environment."""
