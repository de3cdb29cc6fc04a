"""Reinforcement learning with Stable-Baselines3, and its vector environment.

It has trainings, sweeps over seeds, learning curves.
"""
