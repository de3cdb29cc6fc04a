"""Equation of motion, static equilibria, inverse statics and simulation of a scene; `model.py` and
`simulation.py` first."""
