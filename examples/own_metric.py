"""A metric, a model error and a command of your own, in the tables of `evaluate`.
`python examples/own_metric.py`

`PYTHONPATH=examples soft-tendon --import own_metric COMMAND` has them for every command.
"""

from soft_tendon_env import load_scene, register
from soft_tendon_env.cli.main import main
from soft_tendon_env.evaluation.conditions import Condition
from soft_tendon_env.evaluation.metrics import Metric

register("metric", "peak", Metric("peak [N]", lambda episode, first: float(episode.tension.max())))
register("condition", "stiffness-50%", Condition(randomize={"stiffness": 0.5}))


@register("command", "length", description="the length of a scene's rod")
def length(arguments):
    print(f"{sum(segment.length for segment in load_scene(arguments[0]).segments):g} m")


if __name__ == "__main__":
    main(["length", "three_tendon"])
    arm = [
        "--scene",
        "three_tendon",
        "--fidelity",
        "fast",
        "--seconds",
        "2",
        "--episodes",
        "2",
        "--out",
        "out/own_metric",
    ]
    main(["evaluate", "tracking", *arm, "--errors", "nominal", "stiffness-50%"])
