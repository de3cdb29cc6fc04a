"""Scenes: what a user writes of an arm, as Python objects or TOML files.

They have the rod, tendons, strain parametrisation, integrator and effects.
"""
