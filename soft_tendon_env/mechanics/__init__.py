"""Equation of motion of the rod and its integration, as compiled kernels (numba).

They are pure functions, one stage of the derivation per file.

Reading order: `types` (what the kernels read) and `workspace` (what they write), `terms/evaluate`
(one evaluation, phase by phase), and the phases in its order: `terms/tendons`,
`terms/statics_based` or `terms/explicit`, `terms/kinematics`, `terms/dynamics`,
`terms/external_forces`. Then `motion/extrapolation` (one step), `motion/advance` (which steps are
accepted), `motion/batch` (many arms) and `motion/equilibrium` (statics). `algebra` is what they
compute with: SIMD packs, SE(3), symmetric 6x6 and small positive definite matrices.
"""
