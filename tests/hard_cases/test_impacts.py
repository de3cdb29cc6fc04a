"""Impacts: arms thrown on obstacles, and obstacles shot at arms, at up to 30 m/s with steps of 20 ms."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.effects.contact import Contact, contact_forces

DURATION, STEP = 0.06, 0.02  # [s]
SCENES = ("three_tendon", "paper", "four_tendon", "two_segment_six", "helical", "catheter")
FIDELITIES = ("scene", "fast", "standard")


class Case:
    """An arm, an obstacle at a clearance [m] of its outer part, and the speed [m/s] with which its tip or the obstacle flies."""

    def __init__(self, scene, fidelity, kind, speed, *, size=0.005, shot=False, angle=0.0, at=0.8, ahead=0.01, **contact):
        self.scene, self.fidelity, self.speed, self.shot = ste.load_scene(scene), fidelity, speed, shot
        self.length = sum(segment.length for segment in self.scene.segments)
        bare = ste.build_model(self.scene, fidelity=fidelity)
        axis = bare.backbone(np.zeros(bare.coordinate_count), 60)[15:, :3, 3]
        self.radius = bare.discretisation.radius(np.array([self.length]))[0]
        self.towards = np.array([0.0, np.cos(angle), np.sin(angle)])  # the obstacle
        across = np.cross(self.towards, [1.0, 0.0, 0.0])
        own = {
            "floor": {"type": "plane", "axis": (-self.towards).tolist()},
            "wire": {"type": "capsule", "axis": (across + 0.3 * self.towards).tolist(), "radius": size, "length": 4.0 * self.length},
            "plate": {"type": "box", "size": [self.length, size, 3.0 * self.length], "rotation": [np.degrees(angle), 0.0, 0.0]},
            "sphere": {"type": "sphere", "radius": size},
        }[kind]
        place = np.array([(at + 0.25 * (kind == "plate")) * self.length, 0.0, 0.0])
        for _ in range(40):
            self.obstacle = {**own, "position": place.tolist(), "velocity": (-speed * self.towards * shot).tolist()}
            clearance = Contact(obstacles=[self.obstacle]).distances(axis)[0].min() - 1.2 * self.radius
            place = place + (ahead - clearance) * self.towards
        self.core = 0.25 * size if kind == "plate" else 0.5 * size if kind != "floor" else 0.0
        self.changes = {"effects.contact": {"obstacles": [self.obstacle], **contact}}

    def fly(self, period, **integrator):
        """States and places (times, samples, 3) [m] of the samples after every period [s], and energies [J] where there is a potential."""
        model = ste.build_model(self.scene.replace(self.changes), fidelity=self.fidelity)
        model = ste.build_model(model.scene.replace(integrator)) if integrator else model
        q, rate = np.zeros((2, model.coordinate_count))
        if not self.shot:
            terms = model.terms(q, rate)
            rate = np.linalg.pinv(terms.mass, 1e-10) @ terms.tip_jacobian[3:].T @ self.towards
            rate *= self.speed / np.linalg.norm(terms.tip_jacobian[3:] @ rate)
        simulation, states, places = ste.Simulation(model), [], []
        states.append(simulation.reset(q, rate))
        for _ in range(round(DURATION / period)):
            simulation.step(np.zeros(model.tendon_count), period)
            states.append(simulation.state)
        places = np.array([contact_forces(model, state).position for state in states])
        conserves = not self.shot and not states[0].effects.size
        energy = [model.energy(state.q, state.q_dot).total for state in states] if conserves else [1.0, 0.0]
        kinetic = [0.5 * state.q_dot @ model.terms(state.q, state.q_dot).mass @ state.q_dot for state in states[-1:]]
        return places, np.array(energy), kinetic[0]

    def depth(self, places, period):
        """How deep [m] the axis came to be in the obstacle, on straight ways between its places."""
        contact, deepest = Contact(obstacles=[self.obstacle]), 0.0
        for i, (a, b) in enumerate(zip(places[:-1], places[1:], strict=True)):
            for t in np.linspace(0.0, 1.0, 8, endpoint=False):
                deepest = max(deepest, -contact.distances(a + t * (b - a), (i + t) * period).min())
        return deepest


def random_case(seed):
    """Speeds of 0.5 to 20 m/s, each tenth 30; radii from 1 to 30 mm, plates of 0.5 to 10 mm."""
    rng = np.random.default_rng(seed)
    kind, speed = str(rng.choice(["floor", "wire", "plate", "sphere"])), 30.0 if seed % 10 == 9 else 10.0 ** rng.uniform(-0.3, 1.3)
    shot = kind != "floor" and rng.random() < 0.5
    size = 10.0 ** (rng.uniform(-3.3, -2.0) if kind == "plate" else rng.uniform(-3.0, -1.5))
    ahead = rng.uniform(0.1, 1.3) * STEP * speed if shot else 10.0 ** rng.uniform(-2.5, -1.3)
    more = {"friction": float(rng.choice([0.0, 0.5])), "dissipation": float(rng.choice([0.0, 0.3, 1.0]))}
    scene, fidelity, angle = str(rng.choice(SCENES)), str(rng.choice(FIDELITIES)), rng.uniform(0.0, 2.0 * np.pi)
    return Case(scene, fidelity, kind, speed, size=size, shot=shot, angle=angle, at=rng.uniform(0.6, 1.0), ahead=ahead, **more)


def check_flight(case, measured, period=1e-3):
    """Passes nothing and gains no energy, and ends where it ends in calls of a millisecond; how far from there [m]."""
    fine, fine_energy, _ = case.fly(period)
    coarse, energy, _ = case.fly(STEP)
    deepest = case.depth(fine, period)
    gain = max(np.diff(each).max() / each[0] for each in (energy, fine_energy))
    apart = np.linalg.norm(coarse[-1] - fine[-1], axis=1).max()
    measured("axis in the obstacle / half of its size", deepest / case.core if case.core else 0.0)
    measured("largest growth / energy", gain)
    measured("distance to calls of 1 ms / length", apart / case.length)
    assert deepest <= case.core
    assert gain < 0.01
    return apart / case.length


KNOWN = {
    "a sphere of 5 mm at 10 m/s": Case("three_tendon", "standard", "sphere", 10.0, size=0.005, shot=True, at=0.7),
}
