"""Contact with obstacles: smooth penalty with damping, Coulomb friction with sticking, on round samples along the whole arm.

Samples lie evenly along the axis, each a ball of the rod's radius that stands for its share of the length; the tip's stands for its round
cap too. obstacles.py says what a scene may have, distance.py how far a place is from it, samples.py where the arm is looked at, forces.py
what force arises, wrench.py what that is to the arm, step_size.py how long a time step may be; effect.py has the table.
"""

from soft_tendon_env.effects.contact import step_size  # registers its kernels
from soft_tendon_env.effects.contact.effect import Contact

__all__ = ["Contact", "step_size"]
