"""Columns of the rows of numbers that the kernels of contact read: of a sample of the arm and of an obstacle."""

H_A, REACH_A, H_B, REACH_B, T, RADIUS, STIFFNESS, DEPTH, WALL_SCALE, SOLID = range(10)
"""Sample: Hermite polynomials H00 [-], h H10 [m], H01 [-], h H11 [m] at its place t [-] between the nodes a and b of an interval of length
h; radius [m], stiffness k [N/m], smoothing e [m]; scale [J] of the wall's energy, and most thickness [m] that counts."""

KIND, CONVEX, THICKNESS, FRICTION, DISSIPATION, RATE, PHASE, SIZES = range(8)
MOST_SIZES = 4
PLACE, FRAME, VELOCITY, AMPLITUDE = 11, 14, 23, 26
"""Obstacle: number of its shape, whether that is convex, thickness [m], mu [-], c [s/m], rate [rad/s] and phase [rad] of its motion, sizes
[m], and the vectors and the rotation of its motion, see `Obstacle.row`."""
