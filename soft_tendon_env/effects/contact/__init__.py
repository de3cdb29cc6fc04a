"""Contact with obstacles: penalty forces with damping and regularised Coulomb friction.

They act on round samples along the whole arm.
"""

from soft_tendon_env.effects.contact.forces import Contact as Contact
