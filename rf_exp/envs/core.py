"""Episodes of a task, step by step: the common core of all environments."""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rf_exp.constraints import PolicyMonitor, force_evidence, protective_stop
from rf_exp.envs.observations import action_space
from rf_exp.errors import ArgumentError, RfError, unknown_choice
from rf_exp.experiment import EVALUATION_SEED
from rf_exp.observations import ObservationDict, Observations, observe
from rf_exp.sim import Simulator
from rf_exp.tasks import (
    CONFIGURED,
    NO_VARIATION,
    Ledger,
    SuccessEvaluator,
    Task,
    Variation,
    families,
    label_names,
    named_task,
    read_task,
    read_variation,
    scene_draws,
)
from rf_exp.types import CONTROL_HZ, Scene

RENDER_MODES = ("rgb_array",)
METADATA: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": CONTROL_HZ}


class ResetNeeded(RfError, gymnasium.error.ResetNeeded):
    """Error: no episode is under way."""


class EpisodeCore:
    """A simulated task, one episode after the other.

    `task` is a name of conf/task, the path of a YAML file, or a Task; `variation`, how its scenes differ, is
    one of conf/variation or a Variation. An episode ends with success by the strict criterion, with the
    protective stop of two arms that press hard on each other, or after `step_limit` control steps (20 per
    second), by default those of the task. A violation is a control step in which two arms press on each
    other; with `overlaps` also one in which their exact volumes overlap, as evaluation counts it, which takes
    up to as long again as the step. Raises ArgumentError for invalid arguments, and StageError where pictures
    are needed and cannot be rendered.
    """

    def __init__(
        self,
        task: str | Path | Task,
        observations: Observations | None = None,
        *,
        variation: str | Variation = NO_VARIATION,
        step_limit: int | None = None,
        overlaps: bool = False,
        render_mode: str | None = None,
    ) -> None:
        observations = Observations() if observations is None else observations
        if not isinstance(observations, Observations):
            raise ArgumentError(f"observations is {observations!r}; expected a rf_exp.envs.Observations")
        if render_mode not in (None, *RENDER_MODES):
            raise unknown_choice("render_mode", render_mode, (None, *RENDER_MODES))
        resolved_task = find_task(task)
        resolved_variation = read_variation(variation) if isinstance(variation, str) else variation
        resolved_task = (
            replace(resolved_task, variation=resolved_variation)
            if resolved_variation.identity
            else resolved_task
        )
        self.task = resolved_task if step_limit is None else replace(resolved_task, step_limit=step_limit)
        self.observations, self._render_mode = observations, render_mode
        size = {"width_px": observations.width, "height_px": observations.height}
        needs_pictures = observations.needs_rendering or render_mode is not None
        self._simulator: Simulator | None = Simulator(self.task, **size, render=needs_pictures)
        self._declared = observations.declaration_for(self.task)
        self._overlaps = overlaps
        actions = action_space(self.task)
        self._low, self._high = actions.low, actions.high
        self._episode: Episode | None = None  # until the first reset

    def reset(self, seed: int | None, rng: np.random.Generator) -> None:
        """Begins the episode of a seed; without one it is drawn below the first seed of evaluation."""
        if self._simulator is None:
            raise ResetNeeded("the environment is closed; make another one")
        seed = int(rng.integers(EVALUATION_SEED)) if seed is None else int(seed)
        start, task = self._simulator.reset(seed), self._simulator.task
        pairs = tuple(combinations(task.agents, 2))
        monitor = PolicyMonitor(task) if self._overlaps else lambda scene: force_evidence(scene, pairs)
        self._episode = Episode(task, seed, start, monitor, scene_draws(self.task, seed))

    def step(self, action: ArrayLike) -> None:
        """One control step (50 ms): (N, A) joint targets in rad, grippers; clipped to the action space.

        Raises ArgumentError for any other action, ResetNeeded where no episode is under way.
        """
        episode = self._episode
        if self._simulator is None or episode is None or episode.terminated or episode.truncated:
            raise ResetNeeded(
                "no episode is under way; call reset() before the first step, and after the last"
            )
        command = np.minimum(
            np.maximum(checked_action(action, self._low.shape, "action"), self._low), self._high
        )
        episode.update(self._simulator.step(command))  # raises for values that are not finite

    @property
    def episode(self) -> "Episode":
        """The episode that is under way or has ended. Raises ResetNeeded before the first."""
        if self._episode is None:
            raise ResetNeeded("there is no episode yet; call reset() first")
        return self._episode

    def observe(self) -> ObservationDict:
        """The current observation, in new arrays."""
        assert self._simulator is not None  # an episode is under way
        (observation,) = observe(self.episode.scene, self._simulator, [self._declared])
        return self.observations.as_dict(observation)

    def render(self) -> NDArray[np.uint8]:
        """(H, W, 3) RGB of the camera `global`. Raises ArgumentError without `render_mode`."""
        if self._render_mode is None:
            raise ArgumentError("render() was called without a render_mode; expected render_mode='rgb_array'")
        if self._simulator is None or self._episode is None:
            raise ResetNeeded("there is no episode to show; call reset() first")
        return self._simulator.images(["global"])["global"]

    def close(self) -> None:
        """Frees the simulator; may be called again."""
        if self._simulator is not None:
            self._simulator.close()
        self._simulator = None


class Episode:
    """State of one episode and its judgement."""

    def __init__(
        self, task: Task, seed: int, start: Scene, monitor: Callable[[Scene], Any], drawn: Mapping[str, Any]
    ) -> None:
        self.seed, self._drawn = seed, drawn
        self._judge, self._monitor, self._step_limit = SuccessEvaluator(task, start), monitor, task.step_limit
        self.scene, self._verdict, self._violation = start, self._judge(start), monitor(start)
        self._success_paper = self._verdict.success_paper
        self._violations = int(self._violation is not None)
        self._ledger = Ledger()

    def update(self, scene: Scene) -> None:
        """Updates the episode with the scene after the next control step."""
        self.scene, self._verdict, self._violation = scene, self._judge(scene), self._monitor(scene)
        self._ledger.record(scene, self._verdict)
        self._success_paper |= self._verdict.success_paper
        self._violations += self._violation is not None

    @property
    def success(self) -> bool:
        """Whether it has succeeded by the strict criterion, without contact between arms."""
        return self._ledger.success

    @property
    def stopped(self) -> bool:
        """Whether it has ended with a protective stop: arms pressed hard on each other."""
        return not self.success and protective_stop(self.scene)

    @property
    def terminated(self) -> bool:
        """Whether it has ended by itself."""
        return self.success or self.stopped

    @property
    def truncated(self) -> bool:
        """Whether it has ended at the step limit."""
        return not self.terminated and self.scene.step >= self._step_limit

    @property
    def reward(self) -> float:
        """1 in the step that ends in success, otherwise 0."""
        return float(self.success)

    def info(self) -> dict[str, Any]:
        """Information about it so far; new dictionaries with each call."""
        return {
            "seed": self.seed,
            "success": self.success,  # by the strict criterion
            "success_paper": self._success_paper,  # by the paper's, at some step so far
            "stopped": self.stopped,  # protective stop
            "score": self._ledger.score,  # progress from 0 to 1, which is success
            "conditions": dict(self._verdict.evidence),  # of the strict criterion, now
            "measured": {name: condition.value for name, condition in self._verdict.measured.items()},
            "violation": "" if self._violation is None else self._violation.sentence,  # of this step
            "violations": self._violations,  # number of steps with one so far
            "drawn": deepcopy(dict(self._drawn)),  # of the variation; empty where nothing varies
        }


class BaseEnv:
    """Base of the environments around an `EpisodeCore`, whose arguments and errors they share."""

    def __init__(
        self, task: str | Path | Task, observations: Observations | None = None, **options: Any
    ) -> None:
        self.core = EpisodeCore(task, observations, **options)
        self.render_mode: str | None = options.get("render_mode")

    @property
    def task(self) -> Task:
        """The simulated task."""
        return self.core.task

    @property
    def labels(self) -> tuple[str, ...]:
        """Meaning of the values of a segmentation."""
        return label_names(self.task)

    def render(self) -> NDArray[np.uint8]:
        return self.core.render()

    def close(self) -> None:
        self.core.close()


def checked_action(action: object, shape: tuple[int, ...], what: str) -> NDArray[np.float32]:
    """An action as a float32 array. Raises ArgumentError unless it has this shape."""
    expected = f"expected finite numbers of shape {shape}: joint targets in rad, gripper in [-1, 1]"
    try:
        array = np.asarray(action, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{what} is {action!r}; {expected}") from error
    if array.shape != shape:
        raise ArgumentError(f"{what} of shape {array.shape}; {expected}")
    return array


def task_names() -> tuple[str, ...]:
    """The names of the tasks of conf/task."""
    return tuple(sorted(path.stem for path in CONFIGURED.glob("*.yaml")))


def find_task(task: str | Path | Task) -> Task:
    """A task by its name, the path of its YAML file, or itself. Raises ArgumentError."""
    if isinstance(task, Task):
        return task
    if (known_task := named_task(str(task))) is not None:
        return known_task
    path = Path(task)
    if path.suffix != ".yaml":
        raise unknown_choice(
            "task", str(task), (*task_names(), *families(CONFIGURED), "the path of a task's YAML file")
        )
    if not path.is_file():
        raise ArgumentError(f"task {str(task)!r}: there is no such file")
    return read_task(path)
