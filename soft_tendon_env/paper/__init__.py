"""Reproduction of figures 2 to 6 of the paper of the model.

It is Mathew, Renda et al., Dynamics and Control of Soft Robots With Implicit Strain
Parametrization.
"""
