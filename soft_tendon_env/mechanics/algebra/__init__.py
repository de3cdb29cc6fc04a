"""Linear algebra and SE(3) of the kernels, on packs of LANES points: numbers without mechanics."""
