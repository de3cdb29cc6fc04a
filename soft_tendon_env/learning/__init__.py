"""Reinforcement learning with Stable-Baselines3: its vector environment."""
