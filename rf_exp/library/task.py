"""A scene that was read, as the rest of the suite knows tasks: arms, objects and places, and no criteria."""

from collections.abc import Mapping
from dataclasses import dataclass

from rf_exp.tasks import CameraSpec, ObjectSpec, Randomisation, RobotSpec, Task
from rf_exp.tasks.assets import Asset
from rf_exp.transforms import Matrix
from rf_exp.types import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadRobot(RobotSpec):
    """An arm that stands anywhere, in any way."""

    pose: Matrix  # world_from_base (4, 4)
    on_hand: Asset | None  # a camera, say; in the frame of its link

    @property
    def world_from_base(self) -> Matrix:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.pose

    @property
    def mounted(self) -> Asset | None:
        return self.on_hand


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadTask(Task):
    """A scene with what can be said of it. When it is solved, its environment knows."""

    assets: Mapping[str, Asset]
    spots: Mapping[str, Matrix]  # named places: world_from_object (4, 4) of what is put there

    @staticmethod
    def of(
        name: str,
        robots: tuple[ReadRobot, ...],
        assets: Mapping[str, Asset],
        spots: Mapping[str, Matrix],
        below: Mapping[str, str],
    ) -> "ReadTask":
        """`below` names, for what stands on another object, that object."""
        return ReadTask(
            name,
            title=name,
            description=name,
            target_condition="",
            robots=robots,
            objects={
                each: ObjectSpec(asset.name, relative_to=below.get(each)) for each, asset in assets.items()
            },
            # Nobody looks on: sentences cannot speak of the left arm.
            cameras={
                camera: CameraSpec() for camera in ("global", *(f"agent{k + 1}" for k in range(len(robots))))
            },
            success={},
            randomisation=Randomisation(0.0, 0.0, 0.0, 0.0),  # its environment draws the scenes
            assets=assets,
            spots=spots,
        )

    def asset(self, name: str) -> Asset:
        return self.assets[name]

    def places(self, scene: Scene) -> Mapping[str, Matrix]:
        return self.spots

    @property
    def _sides(self) -> dict[str, int]:
        return {}
