"""What things lack is told where they are registered, whatever their kind."""

import pytest

from soft_tendon_env import register
from soft_tendon_env.effects import Effect
from soft_tendon_env.envs import Target
from soft_tendon_env.envs.observation import Group
from soft_tendon_env.evaluation.conditions import Condition
from soft_tendon_env.evaluation.metrics import Metric
from soft_tendon_env.scene.routing import Taper, TendonRouting
from soft_tendon_env.scene.sections import Solid
from soft_tendon_env.scene.strain import ExplicitBasis, RodStrain


def subclass(*bases):
    """A class that adds nothing to its bases."""
    return type("Empty", bases, {"__module__": __name__})


def made_of_a_model(model):
    """A controller that would know nothing of limits."""


def make(model, limits, period):
    """What makes a controller."""


REACH = {"task": "Reach", "description": "what it does"}
LACKING = [
    ("effect", subclass(Effect), {}, "Empty, lacks a method parameters"),
    ("effect", int, {}, "should be a subclass of soft_tendon_env.effects.base.Effect"),
    ("target", subclass(Target), {}, "Empty, lacks draw"),
    ("section", subclass(Solid), {}, "Empty, lacks integrals"),
    ("taper", subclass(Taper), {}, "Empty, lacks size_and_slope"),
    ("routing", subclass(TendonRouting), {}, "Empty, lacks offset_and_slope"),
    ("strain", subclass(ExplicitBasis), {}, "Empty, lacks fields, free, highest_order"),
    ("strain", subclass(RodStrain), {}, "StaticsBased or soft_tendon_env.scene.strain.Explicit"),
    ("observation_group", 3, {}, "should be a Group, not 3"),
    ("observation_group", Group("x", 3), {}, "has values = 3: it should be a function"),
    ("observation_group", Group("x", print, bound=0.0), {}, "has bound = 0.0"),
    ("reward_term", 3, {}, "should be a function of the Tracking, not 3"),
    ("task", 3, {}, "should be a Task, not 3"),
    ("controller", object, REACH, "object, lacks a method act"),
    ("controller", made_of_a_model, REACH, "should be made from a model, limits and the control"),
    ("controller", make, {**REACH, "task": "Rech"}, "task = 'Rech': did you mean 'Reach'"),
    ("controller", make, {"task": "Reach"}, "needs description="),
    ("estimator", object, {}, "object, lacks a method estimate"),
    ("estimator", print, {"prefix": "filtered:"}, "is that of the estimator 'kalman'"),
    ("estimator", print, {"prefix": "two words:"}, "it should be a word and a colon"),
    ("metric", 3, {}, "should be a Metric, not 3"),
    ("metric", Metric("x", 3), {}, "has of_episode = 3"),
    ("condition", 3, {}, "should be a Condition, not 3"),
    ("condition", Condition(randomize={"stifness": 2.0}), {}, "'New': stifness is an unknown key"),
    ("command", 3, {"description": "x"}, "the command's name 'New' should be of small letters"),
    ("algorithm", int, {}, "should be a subclass of Stable-Baselines3's BaseAlgorithm"),
]


@pytest.mark.parametrize(("kind", "thing", "details", "message"), LACKING)
def test_what_a_thing_lacks_is_told_where_it_is_registered(
    forgotten, kind, thing, details, message
):
    with pytest.raises((TypeError, ValueError), match=message):
        register(kind, "New", thing, **details)


TAKEN = [
    ("metric", "return", Metric("x", print), {}),
    ("condition", "a,b", Condition(), {}),
    ("reward_term", "graded_position", print, {}),
    ("observation_group", "history", Group("x", print), {}),
    ("effect", "table", Effect, {}),
    ("command", "train", print, {"description": "x"}),
]


@pytest.mark.parametrize(("kind", "name", "thing", "details"), TAKEN)
def test_names_that_mean_something_else_are_refused(forgotten, kind, name, thing, details):
    with pytest.raises(ValueError, match="taken|choose another|stands between names"):
        register(kind, name, thing, **details)
