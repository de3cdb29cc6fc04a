"""Artifacts of an arm: what takes a simulation or a training to make, is kept in a file, and is found by the arm it was made for."""
