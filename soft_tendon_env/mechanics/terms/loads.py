"""External loads: registry of the compiled functions by which effects add wrenches at the nodes.

Such an effect adds its body-frame wrench at every node (times the node's weight, for a load per length) to `work.wrench`; the
wrenches are projected on the coordinates once, for all effects together (24). Its parameters are a NamedTuple class of its own,
and the compiler walks the scene's tuple of them: an effect that is absent costs nothing.
"""

from numba.extending import overload

from soft_tendon_env.tools.code_digest import selects_code

_KERNELS: dict = {}


def adds_wrench(parameters_class):
    """Decorator: the compiled function (parameters, rod, work) that adds the wrench of an effect with these parameters."""

    def register(function):
        _KERNELS[parameters_class] = function
        selects_code(parameters_class, function)
        return function

    return register


def apply_effects(effects, rod, work):
    """Add the wrenches of all effects of the tuple to work.wrench; twists and poses are known."""
    for effect in effects:
        _KERNELS[type(effect)](effect, rod, work)


@overload(apply_effects)
def _apply_effects_overload(effects, rod, work):
    if len(effects) == 0:
        return lambda effects, rod, work: None
    add = _KERNELS[effects[0].instance_class]

    def walk(effects, rod, work):
        add(effects[0], rod, work)
        apply_effects(effects[1:], rod, work)

    return walk
