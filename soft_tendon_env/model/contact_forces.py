"""Contact forces of a model in a state: per obstacle and along the arm."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.effects.contact.wrench import contact_parameters, number_of_contact, read_contacts
from soft_tendon_env.effects.nodes import nodes_with
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import TOLERANCE, Model
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.types import Array


class ContactForces(NamedTuple):
    """Contact of an arm with its obstacles, in their order; vectors in the world frame, forces on the arm."""

    force: Array  # (obstacles, 3) [N]
    clearance: Array  # (obstacles,) [m] between surfaces, least along the arm; negative: the deepest penetration
    arc_length: Array  # (samples,) [m] of the samples along the arm
    position: Array  # (samples, 3) [m]
    sample_force: Array  # (obstacles, samples, 3) [N] on each sample
    gap: Array  # (obstacles, samples) [m] between the surfaces of sample and obstacle, negative where they overlap

    @property
    def penetration(self) -> Array:
        """Deepest penetration of each obstacle (obstacles,) [m], 0 without contact."""
        return np.maximum(-self.clearance, 0.0)


def contact_forces(model: Model, state: State) -> ContactForces:
    """Contact forces, clearance and penetration of an arm in a state: per obstacle and along the arm.

    The obstacles are those of the model's arm. Raises ValueError where it has no contact, or the state is of other effects.
    """
    work, arm = make_workspace(model.arm), model.arm
    number = number_of_contact(arm.effects)
    if number is None:
        raise ValueError("the model's scene has no table effects.contact")
    if state.names:
        model.check_names(state.names)
    parameters = contact_parameters(arm.effects, number)
    work.xi[:] = model.grid.packed(state.strain)
    work.state[:] = state.effects
    work.clock[0] = state.time
    evaluate_forces(arm, np.zeros(arm.tendons.size), state.q, state.q_dot, TOLERANCE, work)
    own = work.state[arm.effects.first_state[number] : arm.effects.first_state[number + 1]]
    obstacles, samples = len(parameters.obstacles), len(parameters.samples)
    gap, position, force = np.empty((obstacles, samples)), np.empty((samples, 3)), np.empty((obstacles, samples, 3))
    read_contacts(parameters, nodes_with(work.pose, work.eta, work.base, own, state.time), gap, position, force)
    places = model.scene.effects.contact.sample_places(model.discretisation)
    return ContactForces(force.sum(axis=1), gap.min(axis=1), places, position, force, gap)
