"""Reproduction of figures 2 to 6 of Mathew, Renda et al., Dynamics and Control of Soft Robots With
Implicit Strain Parametrization."""
