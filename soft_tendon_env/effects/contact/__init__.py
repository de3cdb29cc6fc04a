"""Contact with obstacles: penalty forces with damping and regularised Coulomb friction, on round samples along the whole arm.

Samples lie evenly along the axis, each a ball of the rod's radius that stands for its share of the length; the tip's stands for its round
cap too. obstacle.py says what all obstacles have, shapes.py which there are, effect.py has the table of the scene.
"""

from soft_tendon_env.effects.contact.effect import Contact as Contact
