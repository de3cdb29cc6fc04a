"""Equation of motion, static equilibria, inverse statics and simulation of a scene.

Read `model.py` and `simulation.py` first.
"""
