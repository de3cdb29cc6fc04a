"""Distributed reinforcement learning with RLlib (Ray): the same trainings, with environments in several processes or on a cluster."""
