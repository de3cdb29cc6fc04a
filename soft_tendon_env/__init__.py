"""Cosserat-rod models, simulation and Gymnasium environments of tendon-driven soft arms.

The models are of reduced order.

The public names for scenes, models, statics and simulation stand in public.py, `identify` in
identification/; importing the package registers the environments, and loads the modules that
installed packages name as entry points. The names are imported when the
first of them is used, so that what needs none of them, such as `soft-tendon --help`, does not wait
for the compiler.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from soft_tendon_env.registration import register_environments
from soft_tendon_env.tools.extensions import load_extensions
from soft_tendon_env.tools.forks import register_fork_handlers

register_environments()
register_fork_handlers()

if TYPE_CHECKING:
    from soft_tendon_env.identification import identify as identify
    from soft_tendon_env.public import *  # noqa: F403
    from soft_tendon_env.public import __all__ as __all__

    __version__: str
else:
    # `identify` is above what public.py may import, and `register` waits for no compiler
    APART = {"identify": "identification", "register": "tools.registry"}
    NOT_SHOWN = {
        "APART",
        "TYPE_CHECKING",
        "NOT_SHOWN",
        "import_module",
        "load_extensions",
        "register_environments",
        "register_fork_handlers",
    }

    def __getattr__(name):
        if name in APART:
            return getattr(import_module(f"{__name__}.{APART[name]}"), name)
        if name == "__version__":
            return import_module("importlib.metadata").version(__name__)
        if name.startswith("_") and name != "__all__":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        public = import_module(f"{__name__}.public")
        if name in public.__all__ or name == "__all__":
            return getattr(public, name)
        if name in globals():  # a part of the package, which came with them
            return globals()[name]
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__():
        from soft_tendon_env.public import __all__

        return sorted({*globals(), *__all__, "identify", "__version__"} - NOT_SHOWN)


load_extensions()  # last: these modules import the names above
