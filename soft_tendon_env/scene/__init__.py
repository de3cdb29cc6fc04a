"""Scenes: what a user writes of an arm, as Python objects or TOML files: rod, tendons, strain
parametrisation, integrator, effects."""
