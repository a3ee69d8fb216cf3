"""LeRobot plug-in: `lerobot-eval --env.type=rf_exp --env.task=lift_barrier`; see docs/environments.md."""

# pyright: reportMissingImports=false
from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from rf_exp.envs import LEROBOT_ID, Observations, lerobot_spaces

KINDS = {"agent_pos": FeatureType.STATE, "environment_state": FeatureType.ENV}


@EnvConfig.register_subclass("rf_exp")
@dataclass
class RfExpEnv(EnvConfig):
    """Environment of one task for one policy of all arms; `features` follow from task and observations."""

    task: str | None = "lift_barrier"  # name in conf/task, or path of a YAML file
    fps: int = 20  # control rate, Hz, fixed by the simulator
    episode_length: int | None = None  # control steps; None: the task's limit
    state: str = "joints"  # joints | full (also the poses of all objects)
    pictures: bool = True
    cameras: str = "all"  # all | local (those of the agents) | global
    width: int = 320
    height: int = 240
    variation: str = "none"  # name in conf/variation
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            "environment_state": OBS_ENV_STATE,
        }
    )

    def __post_init__(self) -> None:
        observed, acts = lerobot_spaces(self.task or "", self._observations)
        self.features[ACTION] = PolicyFeature(FeatureType.ACTION, acts.shape)
        for key in observed.keys() & KINDS.keys():
            self.features[key] = PolicyFeature(KINDS[key], observed[key].shape)
        pixels: Any = observed.get("pixels", {})
        for camera, box in pixels.items():
            key = f"{OBS_IMAGES}.{camera}"
            self.features[key] = PolicyFeature(FeatureType.VISUAL, box.shape)
            self.features_map[key] = key

    @property
    def gym_id(self) -> str:
        return LEROBOT_ID

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {
            "task": self.task,
            "observations": self._observations,
            "variation": self.variation,
            "step_limit": self.episode_length,
        }

    @property
    def _observations(self) -> Observations:
        names = ("state", "pictures", "cameras", "width", "height")
        return Observations(**{name: getattr(self, name) for name in names})
