"""Policies of the authors' release and of the challenge, for `foreign.factory`: docs/foreign.md.

foreign.factory=rf_exp.policy.foreign.robofactory:checkpoint   its .ckpt files: tensors, none of its code runs
foreign.factory=rf_exp.policy.foreign.robofactory:submission   an entry's DeployPolicy, whose code runs
"""

import sys
from collections import deque
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, StageError
from rf_exp.policy.foreign.diffusion import ReleasedPolicy, read_policy
from rf_exp.policy.inputs.view import ACTION_SIZE
from rf_exp.policy.learning.checkpoint import device_of
from rf_exp.tasks import camera_from_release, camera_to_release
from rf_exp.transforms import inverse

OBSERVATION_STEPS = 3  # observation steps of the release's policies
SIZE_PX = 240, 320  # height and width of the release's pictures
GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])


class Checkpoints:
    """Networks of the release, one for each arm or one for all, with the observation steps of training."""

    def __init__(self, networks: Sequence[ReleasedPolicy]) -> None:
        self._networks = networks
        self.observation_steps = max(network.settings.observation_steps for network in networks)
        self._observations: deque[Mapping[str, Any]] = deque(maxlen=self.observation_steps)
        self._generators: list[torch.Generator] = []

    def reset(self, seed: int) -> None:
        """Forgets the last episode; all noise of the next comes from its seed and the network's number."""
        self._observations.clear()
        seeds = [np.random.SeedSequence([seed, row]) for row, _ in enumerate(self._networks)]
        # On the CPU, so that the noise does not depend on the device.
        self._generators = [torch.Generator().manual_seed(int(each.generate_state(1)[0])) for each in seeds]

    def observe(self, observation: Mapping[str, Any]) -> None:
        """Adds an observation. Before an episode's start its first one repeats, as in training."""
        self._observations.extend([observation] * (1 if self._observations else self.observation_steps))

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Actions (T, N, 8), as many as networks execute. Raises StageError for another number of arms."""
        agents, expected = len(observation["qpos"]), sum(network.agents for network in self._networks)
        if agents != expected:
            raise StageError(f"the checkpoints command {expected} arms, and the task has {agents}")
        if not self._observations:
            raise StageError(
                "a checkpoint needs several observation steps, which only foreign.factory provides"
            )
        first, chunks = 0, []
        for network, generator in zip(self._networks, self._generators, strict=True):
            own = slice(first, first + network.agents)
            observations = [*self._observations][-network.settings.observation_steps :]
            commands = np.stack([each["commanded"][own].reshape(-1) for each in observations]).astype(
                np.float32
            )
            pictures = {
                name: self._pictures(network, name, first, observations) for name in network.settings.cameras
            }
            chunk = network.act(pictures, commands, generator)
            chunks.append(chunk.reshape(len(chunk), network.agents, ACTION_SIZE))
            first += network.agents
        steps = min(map(len, chunks))
        return np.concatenate([chunk[:steps] for chunk in chunks], axis=1)

    def _pictures(
        self, network: ReleasedPolicy, name: str, first: int, observations: Sequence[Mapping[str, Any]]
    ) -> NDArray[np.uint8]:
        """Pictures (O, H, W, 3) of one camera. A network of one arm has that arm's own camera."""
        camera = camera_from_release(name, network.agents)
        camera = f"agent{first + 1}" if camera == "agent1" and network.agents == 1 else camera
        expected = network.settings.cameras[name]
        return np.stack([picture(each, camera, (expected.height, expected.width)) for each in observations])


class Submission:
    """The DeployPolicy of an entry, which gets observations in the format of ManiSkill, in batches of one."""

    def __init__(self, policy: Any, observation_steps: int) -> None:
        self._policy, self.observation_steps = policy, observation_steps

    def reset(self, seed: int) -> None:
        """Seeds the random number generators by the scene, as the challenge does."""
        np.random.seed(seed % 2**32)
        torch.manual_seed(seed)
        self._policy.reset()

    def observe(self, observation: Mapping[str, Any]) -> None:
        """Adds an observation."""
        self._policy.update_obs(as_maniskill(observation))

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.floating]:
        """Actions (T, N * 8)."""
        return np.stack([np.asarray(action).reshape(-1) for action in self._policy.get_action()])


def picture(observation: Mapping[str, Any], camera: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Picture (H, W, 3) of a camera. Raises StageError where it is not observed, or in another size."""
    image = observation.get(f"rgb_{camera}")
    if image is None:
        cameras = ", ".join(sorted(key for key in observation if key.startswith("rgb_"))) or "none"
        raise StageError(
            f"it needs camera {camera!r}; observed are {cameras}: set foreign.observations.cameras"
        )
    if image.shape[:2] != size:
        raise StageError(
            f"camera {camera!r} gives pictures {image.shape[1]} x {image.shape[0]}, but it was trained on "
            f"another size; use picture='{{width: {size[1]}, height: {size[0]}}}'"
        )
    return image


def as_maniskill(observation: Mapping[str, Any]) -> dict[str, Any]:
    """An observation in the format of the release's environments: their names, tensors in batches of one."""
    agents = len(observation["qpos"])
    joints = [
        {key: torch.from_numpy(observation[key][row])[None] for key in ("qpos", "qvel")}
        for row in range(agents)
    ]
    cameras = [key.removeprefix("rgb_") for key in observation if key.startswith("rgb_")]
    data, parameters = dict[str, Any](), dict[str, Any]()
    for camera in cameras:
        name = camera_to_release(camera, agents)
        data[name] = {"rgb": torch.from_numpy(picture(observation, camera, SIZE_PX))[None]}
        if (world_from_camera := observation.get(f"world_from_camera_{camera}")) is not None:
            arrays = {
                "extrinsic_cv": inverse(world_from_camera)[:3],
                "cam2world_gl": world_from_camera @ GL_FROM_CV,
                "intrinsic_cv": observation[f"intrinsics_{camera}"],
            }
            tensors = {key: torch.from_numpy(each.astype(np.float32))[None] for key, each in arrays.items()}
            parameters[name] = tensors
    arms = joints[0] if agents == 1 else {f"panda-{row}": each for row, each in enumerate(joints)}
    return {"agent": arms, "extra": {}, "sensor_param": parameters, "sensor_data": data}


def checkpoint(
    paths: str | Sequence[str],
    sampler: str | None = None,
    inference_steps: int | None = None,
    device: str = "auto",
) -> Checkpoints:
    """The policy of one `.ckpt`, or of one for each arm, in their order.

    It samples as its file says, unless `sampler` (ddpm, ddim) and `inference_steps` say otherwise.
    """
    files = [Path(each) for each in ([paths] if isinstance(paths, str) else paths)]
    if not files:
        raise ArgumentError("foreign.options.paths is empty; expected a .ckpt, or one for each arm")
    networks = [read_policy(path, sampler, inference_steps) for path in files]
    return Checkpoints([network.to(device_of(device)) for network in networks])


def submission(
    folder: str, checkpoint: str | None = None, observation_steps: int = OBSERVATION_STEPS
) -> Submission:
    """An entry of the challenge: `custom_policy/deploy_policy.py` in its folder, whose code runs.

    It gets `checkpoint`, by default the only file in `checkpoints/`, and the last `observation_steps`
    observations before each call.
    """
    code = Path(folder) / "custom_policy/deploy_policy.py"
    if not code.is_file():
        raise ArgumentError(f"there is no {code}; expected the folder of a submission")
    checkpoints = sorted((Path(folder) / "checkpoints").glob("*.ckpt"))
    if checkpoint is None and len(checkpoints) != 1:
        names = ", ".join(each.name for each in checkpoints) or "none"
        raise ArgumentError(f"{folder}/checkpoints holds {names}; name one: foreign.options.checkpoint")
    weights = Path(checkpoint) if checkpoint else checkpoints[0]
    if not weights.is_file():
        raise ArgumentError(f"there is no {weights}; expected the checkpoint of a submission")
    if observation_steps < 1:
        raise ArgumentError(f"observation_steps is {observation_steps}; expected at least 1")
    sys.path.insert(0, str(code.parent.resolve()))  # for modules beside it, as in the challenge
    sys.modules.pop("deploy_policy", None)  # that of another entry
    policy_class = getattr(import_module("deploy_policy"), "DeployPolicy", None)
    if policy_class is None:
        raise ArgumentError(f"{code} has no class DeployPolicy")
    return Submission(policy_class(str(weights)), observation_steps)
