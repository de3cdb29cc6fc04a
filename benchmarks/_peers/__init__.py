"""Simulators that the same arm is put into, one file each: `own`, `mujoco_chain`, `elastica_rod`,
`soromox_strains`.

Each has what `simulator.py` states, made from a scene of this package through public interfaces
alone.
"""
