"""Policies by name: controllers, trained agents and policies of users.

A name is parsed once into a type.

name = PolicyName.parse("filtered:predictive@standard", "TipPose")
env = gym.make("TendonRod-TipPose-v0", **name.options({}))
policy = name.load(env)
"""

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Union

import gymnasium as gym

from soft_tendon_env.accuracy.fidelity import AS_SCENE, build_model, checked_fidelity
from soft_tendon_env.control.catalogue import Entry, controllers_of, valid_controllers
from soft_tendon_env.control.own_cost import Given
from soft_tendon_env.control.uncertainty import USUAL
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.options import Options, given_scene
from soft_tendon_env.model.model import Model
from soft_tendon_env.policies.agent import (
    ARM,
    INTERFACE,
    OF_COORDINATES,
    AgentConfig,
    find_agent,
    is_agent,
    layout_of,
    load_agent,
    read_config,
    shipped,
)
from soft_tendon_env.policies.controller_policy import make_policy, observation_options
from soft_tendon_env.policies.estimators import ESTIMATORS
from soft_tendon_env.policies.filtered_agent import FilteredAgent
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.policies.trained_arm import listed_numbers, numbers_outside, undisturbed
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import (
    Configuration,
    not_among,
    read_toml,
    shown,
)
from soft_tendon_env.tools.files import digest, digests

BEST = "best"  # name of the folder of a training's best agent, within that of the training
ALL = "all"  # name of all controllers of the catalogue together
ESTIMATOR = "estimator."  # prefix of parameters of the state estimator among those of a controller

USUAL_NAMES = {
    "mpc": ("predictive", "model-predictive control"),
    "nmpc": ("predictive", "model-predictive control"),
    "osc": ("tracking", "operational-space control"),
    "ik": ("feedforward", "inverse statics"),
}
"""Usual names of methods: the controller of this package, and the method."""

ZIP = (
    "a file of Stable-Baselines3 does not say what its agent observes. Write a module mine.py and"
    " name the policy mine:agent:\n"
    "    from stable_baselines3 import PPO  # or what trained it; the statistics of a VecNormalize"
    " are not in the file\n"
    "    def agent(env): return PPO.load({path!r})\n"
    '    agent.options = {{"observation": [...]}}  # and preview, history, sensors, action,'
    " tension_rate, as in its training"
)


@dataclass(frozen=True)
class PolicyName:
    """Name of a policy for a task, and what the name means."""

    text: str  # the name as it was written
    task: str  # "TipPose" or another

    @staticmethod
    def parse(text: str, task: str) -> Union["Controller", "Agent", "UserPolicy"]:
        """Parses the name of a policy.

        Of a controller, an agent and a policy of a user's own it is the first that fits.

        Args:
            text: the name, see `load_policy`.
            task: name of the task.

        Returns:
            The policy that the name means.

        Raises:
            ValueError: for other names; the error says what names exist.
        """
        path = Path(text)
        if is_agent(text):
            return Agent(text, task, text)
        if path.suffix == ".toml" and path.is_file():
            return _tuned_controller(text, task)
        estimator, prefix = _estimator_of(text)
        _, method, behind = split_name(text)
        is_controller = method in controllers_of(task)
        is_filtered_agent = bool(prefix) and is_agent(method)
        belief = None
        if behind and (is_controller or is_filtered_agent):
            belief = _checked_belief(text, behind.removeprefix("@"))
        if is_controller:
            return Controller(text, task, method, estimator, belief)
        if is_filtered_agent:
            return Agent(text, task, method, estimator, belief)
        module, colon, name = text.partition(":")
        if colon and not prefix:
            return UserPolicy(text, task, module, name)
        raise ValueError(f"policy is {text!r}{_what_it_should_be(text, task, prefix, method)}")

    def options(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Returns options of an environment in which the policy sees what it needs.

        Args:
            given: options that are set already.

        Returns:
            Both together, by name.

        Raises:
            ValueError: for options that the policy cannot act with.
            OSError: where a file cannot be read.
        """
        raise NotImplementedError

    def load(self, env: Any, scene: Scene | None = None, other_effects: bool = False) -> Policy:
        """Loads the policy for an environment with its options.

        Args:
            env: the environment.
            scene: of a controller's assumed model, by default the environment's, at the fidelity
                that the name says, if it says one.
            other_effects: whether the arm may have effects that an agent was not trained with.

        Returns:
            The policy.

        Raises:
            ValueError: for files or models that do not fit the environment.
            OSError: where a file cannot be read.
            ModuleNotFoundError: where a module cannot be found.
        """
        raise NotImplementedError

    def load_beyond_training(self, env: Any) -> Policy:
        """Loads the policy for an environment whose arm may be none that it was trained for.

        Args:
            env: the environment.

        Returns:
            The policy, as by `load` where it was not trained.

        Raises:
            ValueError: for files or models that do not fit the environment.
            OSError: where a file cannot be read.
        """
        return self.load(env)

    def outside(self, env: Any) -> str:
        """Returns the numbers of an arm for which the policy was not trained.

        Args:
            env: the environment of the arm.

        Returns:
            The numbers and what they were in its training, in words; "" without any.

        Raises:
            ValueError: for files that do not fit.
            OSError: where a file cannot be read.
        """
        return ""

    def fingerprint(self) -> Any:
        """Returns plain values that tell the policy from others.

        Returns:
            Its name, and digests of its files.

        Raises:
            ValueError: for files that do not fit.
            OSError: where a file cannot be read.
        """
        return self.text


def _tuned_controller(text: str, task: str) -> "Controller":
    """The controller that a file of parameters has.

    Raises ValueError.
    """
    tuned = TunedController.parse(read_toml(Path(text)), text)
    named = PolicyName.parse(tuned.policy, task)
    if not isinstance(named, Controller):
        raise ValueError(f"{text}: policy is {tuned.policy!r}: it should be a controller")
    return named.with_parameters(tuned.parameters, text)


def _checked_belief(text: str, fidelity: str) -> str:
    """Fidelity behind '@' in the name of a policy. Raises ValueError."""
    try:
        checked_fidelity(fidelity)
    except ValueError as error:
        raise ValueError(f"policy is {text!r}: what stands behind '@' {error}") from error
    return fidelity


def _estimator_of(text: str) -> tuple[str | None, str]:
    """Name of the estimator that a policy's name begins with, and its prefix; None, "" without."""
    for name, entry in ESTIMATORS.items():
        if text.startswith(entry.prefix):
            return name, entry.prefix
    return None, ""


def split_name(text: str) -> tuple[str, str, str]:
    """Parts of a policy's name: what stands before a controller or agent, it, and what is behind.

    The first is "filtered:" or "", the last "@" with a fidelity or "". The parts make up the name.
    """
    _, prefix = _estimator_of(text)
    behind = text.removeprefix(prefix)
    method, mark, fidelity = behind.rpartition("@")
    is_folder = Path(behind).is_dir()  # whose name may have an "@" too
    if not mark or is_folder:
        return prefix, behind, ""
    return prefix, method, mark + fidelity


def _what_it_should_be(text: str, task: str, prefix: str, method: str) -> str:
    """End of the message on a name that no policy has: what it should be."""
    usual = USUAL_NAMES.get(method.lower())
    if usual is not None:
        controller, words = usual
        return f": it should be {prefix + controller!r}, this package's {words}"
    path = Path(text.removeprefix(prefix))
    if path.suffix == ".zip" and not prefix:
        return f": {ZIP.format(path=text)}"
    agents = f"the folder of an agent (of a training: {path / BEST}), {', '.join(shipped())}"
    controllers = f"a controller of {task}; {valid_controllers(method, task)}"
    if prefix:
        return f": what stands behind {prefix!r} should be {agents}, which ship, or {controllers}"
    return f", no policy: it should be {agents}, which ship, module:name, or {controllers}"


def believed_model(env: Any, scene: Scene | None, fidelity: str | None) -> Model | None:
    """Model that a controller or an estimator assumes; None: that of the environment.

    Args:
        env: the environment.
        scene: of the model, None: that of the environment.
        fidelity: of the model, None: that of the scene.
    """
    if fidelity is None and scene is None:
        return None
    believed = scene or episodes_of(env).model.scene
    return build_model(believed, fidelity or AS_SCENE)


class TunedController(Configuration):
    """A controller's name and parameters, as `soft-tendon tune` writes them.

    See `Controller.defaults`.
    """

    policy: str
    parameters: dict[str, int | float]


@dataclass(frozen=True)
class Controller(PolicyName):
    """A controller of the catalogue.

    NAME, where its coordinates are observed; filtered:NAME, where an extended Kalman filter finds
    them, with loads and the timing of commands. NAME@FIDELITY assumes a model of another fidelity
    than the arm's.
    """

    name: str
    estimator: str | None
    belief: str | None
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)

    def with_parameters(
        self, parameters: Mapping[str, float], text: str | None = None
    ) -> "Controller":
        """The controller with other parameters, and another name.

        Raises ValueError for parameters that it has not.
        """
        for name in parameters.keys() - self.defaults.keys():
            raise ValueError(
                f"parameters has {name!r}, which {self.text} has not:"
                f" {not_among(name, self.defaults)}"
            )
        return replace(self, text=text or self.text, parameters=dict(parameters))

    @property
    def defaults(self) -> dict[str, float]:
        """Parameters where nothing is tuned.

        They are of the catalogue's entry, and behind "estimator." of the Kalman filter's
        Uncertainty.
        """
        defaults = dict(controllers_of(self.task)[self.name].parameters)
        if self.estimator is not None and ESTIMATORS[self.estimator].filters:
            for name, value in USUAL._asdict().items():
                defaults[f"{ESTIMATOR}{name}"] = value
        return defaults

    @property
    def entry(self) -> Entry:
        """The catalogue's entry, with its parameters."""
        entry = controllers_of(self.task)[self.name]
        numbers = {}
        for name, value in self.parameters.items():
            if not name.startswith(ESTIMATOR):
                numbers[name] = value
        return entry.with_parameters(numbers) if numbers else entry

    def options(self, given: Mapping[str, Any], regime: str | None = None) -> dict[str, Any]:
        """regime: information regime of the estimator, see `observation_options`."""
        options = Options.parse(dict(given), "options")
        actuators = given_scene(options.scene).effects.actuators
        late = None if actuators is None else actuators.delay or None
        own = observation_options(
            self.entry,
            self.task,
            options.control_period,
            late,
            self.estimator,
            regime,
        )
        return {**own, **given}

    def load(
        self,
        env: Any,
        scene: Scene | None = None,
        other_effects: bool = False,
        objectives: Sequence[Given] | None = None,
    ) -> Policy:
        """objectives: a cost of the user's own, see `make_policy`."""
        changes = {}
        for name, value in self.parameters.items():
            if name.startswith(ESTIMATOR):
                changes[name.removeprefix(ESTIMATOR)] = value
        model = believed_model(env, scene, self.belief)
        uncertainty = USUAL._replace(**changes)
        return make_policy(
            self.entry,
            env,
            model,
            estimator=self.estimator,
            uncertainty=uncertainty,
            objectives=objectives,
        )

    def fingerprint(self) -> Any:
        return [self.text, dict(self.parameters)]


@dataclass(frozen=True)
class Agent(PolicyName):
    """A trained agent: the name of one that ships for the task, or its folder.

    "agent" stands for the best of them. filtered:NAME is an agent that sees what an extended Kalman
    filter estimates; filtered:NAME@FIDELITY one whose filter's model has another fidelity.
    """

    agent: str  # its name or folder, without what stands around it
    estimator: str | None = None
    belief: str | None = None

    @property
    def folder(self) -> Path:
        """Its folder.

        Raises ValueError, FileNotFoundError.
        """
        return find_agent(self.agent, self.task)

    @property
    def config(self) -> AgentConfig:
        """The configuration of its training.

        Raises ValueError, OSError.
        """
        return read_config(self.folder)

    def with_folder(self, folder: Path) -> str:
        """Name of the agent in another folder, behind the same estimator if there is one."""
        before, _, behind = split_name(self.text)
        return f"{before}{folder}{behind}"

    @property
    def arm(self) -> dict[str, Any]:
        """Options of the arm that it was trained on, all of them.

        Raises ValueError, OSError.
        """
        options = Options.parse(undisturbed(self.config.options), "options")
        return options.model_dump(mode="json", include=set(ARM))

    def options(self, given: Mapping[str, Any]) -> dict[str, Any]:
        own = {}
        for key, value in undisturbed(self.config.options).items():
            if key in (*ARM, *INTERFACE):
                own[key] = value
        # before options that follow from it, such as the preview, are refused in its place
        period = self.arm["control_period"]
        other_period = given.get("control_period", period)
        if other_period != period:
            raise ValueError(
                f"{self.text} was trained with control_period = {period!r}, and acts at no other:"
                f" control_period is {other_period!r}"
            )
        return {**own, **given}

    def load(self, env: Any, scene: Scene | None = None, other_effects: bool = False) -> Policy:
        agent = load_agent(self.agent, env, other_effects)
        return self._behind_estimator(agent, env, scene)

    def load_beyond_training(self, env: Any) -> Policy:
        agent = load_agent(self.agent, env, beyond_training=True)
        return self._behind_estimator(agent, env)

    def _behind_estimator(self, agent: Policy, env: Any, scene: Scene | None = None) -> Policy:
        """The agent behind its estimator, whose model has a scene, by default the environment's."""
        if self.estimator is None:
            return agent
        model = believed_model(env, scene, self.belief) or episodes_of(env).model
        return FilteredAgent(agent, env, model, ESTIMATORS[self.estimator])

    def outside(self, env: Any) -> str:
        trained = Options(**self.config.options)
        return listed_numbers(numbers_outside(trained, episodes_of(env).model.scene))

    def fingerprint(self) -> Any:
        files = digests(self.folder)
        return files if self.estimator is None else [self.estimator, self.belief, files]


@dataclass(frozen=True)
class UserPolicy(PolicyName):
    """A user's policy, module:name.

    A callable gets a `policy_environment` and returns an object with Stable-Baselines3's `predict`.

    Its attribute `options`, if it has one, says what it observes and how its actions are read:
    those of INTERFACE.
    """

    module: str
    name: str

    @property
    def maker(self) -> Callable[..., Any]:
        """Callable that makes the policy.

        Raises ValueError where there is no such thing.
        """
        try:
            module = importlib.import_module(self.module)
            made: Callable[..., Any] = getattr(module, self.name)
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(
                f"policy is {self.text!r}: it should be module:name of what makes a policy; {error}"
            ) from error
        return made

    def options(self, given: Mapping[str, Any]) -> dict[str, Any]:
        options = getattr(self.maker, "options", {})
        other = [str(name) for name in options if name not in INTERFACE]
        if other:
            raise ValueError(
                f"policy is {self.text!r}, whose options have {', '.join(other)}: it may set"
                f" {', '.join(INTERFACE)} alone"
            )
        Options.parse(dict(options), f"options of {self.text}")
        return {**options, **given}

    def load(self, env: Any, scene: Scene | None = None, other_effects: bool = False) -> Policy:
        made: Policy = self.maker(policy_environment(env, scene))
        if not hasattr(made, "predict"):
            raise ValueError(
                f"policy is {self.text!r}: {self.name} should make an object with predict, not"
                f" {shown(made)}"
            )
        for key in ("observation_space", "action_space"):
            space = getattr(made, key, None)
            spaces = [getattr(env, name) for name in (f"single_{key}", key) if hasattr(env, name)]
            if isinstance(space, gym.Space) and space not in spaces:
                raise ValueError(
                    f"policy is {self.text!r}, made for the {key} {space}: the environment's is"
                    f" {spaces[0]}{_other_sizes(space, episodes_of(env))}"
                )
        return made

    def fingerprint(self) -> Any:
        file = getattr(importlib.import_module(self.module), "__file__", None)
        return [self.text, None if file is None else digest(Path(file))]


def _other_sizes(space: gym.Space[Any], episodes: Episodes) -> str:
    """Why an observation of another size may be of the same groups, in words; "": it is not."""
    box = space["observation"] if isinstance(space, gym.spaces.Dict) else space
    layout = layout_of(episodes)
    parts = [f"{group} ({size})" for group, size in layout.items()]
    sizes = ", ".join(parts)
    depending = [group for group in layout if group in OF_COORDINATES]
    if not isinstance(box, gym.spaces.Box) or box.shape == episodes.layout.space.shape:
        return ""
    text = f". It has {sizes}"
    if depending and not episodes.options.history:
        coordinates = episodes.model.coordinate_count
        of_coordinates = sum(layout[group] for group in depending) // coordinates
        difference = math.prod(box.shape) - sum(layout.values())
        others = coordinates + difference / of_coordinates
        text += (
            f"; {', '.join(depending)} have an entry for each of the arm's {coordinates}"
            " coordinates, whose number depends on the fidelity, here"
            f" {episodes.options.fidelity!r}"
        )
        if others == int(others) > 0:
            text += (
                f": an arm with {int(others)} has observations of that size. Evaluate at the"
                " fidelity of the training, or train with groups that do not depend on it, such as"
                " 'measurable'"
            )
    return text


def policy_environment(env: Any, scene: Scene | None = None) -> Any:
    """Environment with the spaces, control period and limits of another, single or vector.

    It shares nothing with it. Its arm is the scene, or that of the environment, without what
    `randomize` draws but noise; its targets are the task's usual ones.
    """
    episodes = episodes_of(env)
    names = (*ARM, *INTERFACE, "threshold")
    options = {name: getattr(episodes.options, name) for name in names}
    options["randomize"] = {"noise": episodes.options.randomize.noise}
    if scene is not None:
        options["scene"] = scene
        options["fidelity"] = AS_SCENE
    id = IDS[episodes.task.name]
    if isinstance(env, gym.Env):
        return gym.make(id, **options)
    return gym.make_vec(id, num_envs=episodes.size, threads=1, **options)


def policy_options(name: str, task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Returns options of an environment in which a policy sees what it needs.

    Args:
        name: of the policy, see `load_policy`.
        task: name of the task, "TipPose", "Shape" or "Reach".
        given: options that are set already.

    Returns:
        Both together, by name.

    Raises:
        ValueError: for a name that is not known, or options that the policy cannot act with.
        OSError: where an agent's file cannot be read.
    """
    return PolicyName.parse(name, task).options(given)


def load_policy(name: str, env: Any, objectives: Sequence[Given] | None = None) -> Policy:
    """Loads the policy of a name for an environment with the options that it needs.

    See `policy_options` for these options.

    Args:
        name: a controller's; an agent's folder, "agent" or another of those that ship for the
            environment's task, see agents/trained; filtered:NAME, one of them behind a Kalman
            filter; with @FIDELITY behind it where its model has another fidelity; module:name of
            what makes one.
        env: single or vector environment of this package.
        objectives: a cost of your own, for a predictive controller alone, see `make_policy`.

    Returns:
        The policy, to be used with `predict`.

    Raises:
        TypeError: for environments of other packages, and objectives that are none.
        ValueError: for a name that is not known, files that do not fit, or objectives that do not.
        OSError: where a file cannot be read.
        ModuleNotFoundError: where a module cannot be found.
    """
    policy = PolicyName.parse(name, episodes_of(env).task.name)
    if objectives is None:
        return policy.load(env)
    if not isinstance(policy, Controller):
        raise ValueError(
            f"objectives are given to {name!r}: predictive controllers alone may have some"
        )
    return policy.load(env, objectives=objectives)
