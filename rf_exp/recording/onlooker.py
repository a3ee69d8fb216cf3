"""A rollout before larger cameras than those that policies look through."""

import numpy as np

from rf_exp.sim import Simulator
from rf_exp.transforms import position_and_quaternion
from rf_exp.types import Rollout, RolloutStep, Scene


class Onlooker:
    """An observer of the rollout loop that keeps another simulator at the same scene, for who draws it.

    Nothing is simulated there: arms and things are put where they were measured. It goes before the observers
    that draw.
    """

    def __init__(self, world: Simulator, seed: int) -> None:
        self._world = world
        world.reset(seed)

    def begun(self, scene: Scene) -> None:
        """The start, where the other simulator stands by itself."""

    def rolled(self, step: RolloutStep) -> None:
        """One control step."""
        poses = {**step.scene.poses, **step.scene.clutter}
        placed = {name: np.array(position_and_quaternion(pose)) for name, pose in poses.items()}
        self._world.place(step.scene.qpos, placed)

    def ended(self, result: Rollout) -> None:
        """Nothing is left to be shown."""
