"""System identification: parameters of an arm's scene from measured marker positions.

It has intervals and held-out errors.
"""

from soft_tendon_env.identification.identify import Estimate, identify, randomize
from soft_tendon_env.identification.markers import Frame, Marker, MarkerSet, load_markers

__all__ = ["Estimate", "Frame", "Marker", "MarkerSet", "identify", "load_markers", "randomize"]
