"""Equations of motion (23) at one state: strains, kinematics, loads, Lagrangian terms.

`evaluate` names the phases in order.
"""
