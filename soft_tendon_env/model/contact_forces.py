"""Contact forces of a model in a state: per obstacle and along the arm."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.effects.contact.forces import read_contacts
from soft_tendon_env.effects.contact.samples import nodes_with
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import TOLERANCE, Model
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.types import Array


class ContactForces(NamedTuple):
    """Contact of an arm with its obstacles, in their order.

    Vectors are in the world frame, forces on the arm.
    """

    force: Array  # (obstacles, 3) [N]
    # (obstacles,) [m] between surfaces, least along the arm; negative: the deepest penetration
    clearance: Array
    penetration: Array  # (obstacles,) [m] the deepest, 0 without contact
    arc_length: Array  # (samples,) [m] of the samples along the arm
    position: Array  # (samples, 3) [m]
    sample_force: Array  # (obstacles, samples, 3) [N] on each sample
    # (obstacles, samples) [m] between the surfaces of sample and obstacle, negative where they
    # overlap
    gap: Array


def contact_forces(model: Model, state: State) -> ContactForces:
    """Computes contact forces, clearance and penetration in a state.

    Args:
        model: of an arm with obstacles.
        state: of that model.

    Returns:
        Forces [N] and distances [m] by obstacle and by sample along the arm.

    Raises:
        ValueError: for a model without contact.
    """
    contact = model.scene.effects.contact
    if contact is None:
        raise ValueError("the model's scene has no table effects.contact")
    parameters = contact.parameters(model.discretisation)
    work = make_workspace(model.arm)
    work.strain.xi[:] = model.grid.packed(state.strain)
    work.inputs.clock[0] = state.time
    no_tension = np.zeros(model.tendon_count)
    evaluate_forces(model.arm, no_tension, state.q, state.q_dot, TOLERANCE, work)
    kinematics = work.kinematics
    nodes = nodes_with(kinematics.pose, kinematics.eta, kinematics.base, state.time)
    obstacle_count = len(parameters.obstacles)
    sample_count = len(parameters.samples)
    gap = np.empty((obstacle_count, sample_count))
    position = np.empty((sample_count, 3))
    force = np.empty((obstacle_count, sample_count, 3))
    read_contacts(parameters, nodes, gap, position, force)
    clearance = gap.min(axis=1)
    return ContactForces(
        force=force.sum(axis=1),
        clearance=clearance,
        penetration=np.maximum(-clearance, 0.0),
        arc_length=contact.sample_places(model.discretisation),
        position=position,
        sample_force=force,
        gap=gap,
    )
