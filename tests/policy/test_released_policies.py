"""Policies of the authors' release: checkpoints with known weights, challenge entries, invalid files."""

import io
import os
import pickle
import sys
import types
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, RfError, StageError
from rf_exp.observations import Observations
from rf_exp.policy import Foreign, make_policy, rollout
from rf_exp.policy.foreign.diffusion import read_policy
from rf_exp.policy.foreign.robofactory import as_maniskill, checkpoint, picture, submission
from rf_exp.policy.foreign.runner import ForeignRunner
from rf_exp.policy.foreign.tensors import Checkpoint
from rf_exp.types import Scene, Verdict
from tests.conftest import read_task
from tests.policy import release_checkpoints as theirs
from tests.policy.scripted import FASTEST_RAD, Puppets

TWO = read_task("lift_barrier")
OBSERVED = Observations(state="joints", pictures=True, width=theirs.SIZE[1], height=theirs.SIZE[0])
SCHEDULE: Any = {"num_train_timesteps": theirs.TIMESTEPS, "beta_schedule": "squaredcos_cap_v2"}
SPEC = Foreign("theirs", "a.b:c", None, None, 5.0, 5.0, None, None, 0, OBSERVED)


def moments(
    cameras: tuple[str, ...], agents: int, size: tuple[int, int] = theirs.SIZE
) -> list[dict[str, Any]]:
    """Three different observations."""
    rng = np.random.default_rng(1)
    return [
        {
            "qpos": rng.normal(size=(agents, 9)).astype(np.float32),
            "qvel": rng.normal(size=(agents, 9)).astype(np.float32),
            "commanded": rng.normal(size=(agents, 8)).astype(np.float32),
            **{f"rgb_{name}": rng.integers(0, 256, (*size, 3), np.uint8) for name in cameras},
        }
        for _ in range(theirs.OBSERVATION_STEPS)
    ]


def act_after(policy: Any, seen: list[dict[str, Any]], seed: int = 5) -> NDArray[np.float32]:
    policy.reset(seed)
    for each in seen:
        policy.observe(each)
    return policy.act(seen[-1])


def noise(seed: int, row: int = 0) -> torch.Generator:
    drawn = np.random.SeedSequence([seed, row]).generate_state(1)[0]
    return torch.Generator().manual_seed(int(drawn))


def pictures_of(seen: list[dict[str, Any]], camera: str, brightest: float = 1.0) -> torch.Tensor:
    pictures = np.stack([each[f"rgb_{camera}"] for each in seen])
    return torch.from_numpy(pictures).movedim(-1, 1).float() * (brightest / 255)


# -- known weights -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_each_arm_has_the_network_of_its_file_its_own_camera_and_noise(tmp_path: Path) -> None:
    written = theirs.write(tmp_path / "300.ckpt")
    seen, network = moments(("agent1", "agent2"), 2), theirs.network(("head_cam",), 1)
    both, scheduler = act_after(checkpoint([str(written)] * 2), seen), DDPMScheduler(**SCHEDULE)
    scheduler.set_timesteps(theirs.TIMESTEPS)
    assert both.shape == (theirs.STEPS, 2, 8) and np.ptp(both) > 0.1
    for row, camera in enumerate(("agent1", "agent2")):
        agent_pos = torch.from_numpy(np.stack([each["commanded"][row] for each in seen]))
        expected = theirs.actions(
            network, scheduler, {"head_cam": pictures_of(seen, camera)}, agent_pos, noise(5, row)
        )
        assert np.abs(both[:, row] - expected.numpy()).max() < 1e-3


@pytest.mark.slow
def test_one_network_of_all_arms_takes_pictures_as_its_file_says(tmp_path: Path) -> None:
    """Values up to 255, channels last, cropped to the centre, normalised once; and another sampler."""
    cameras = ("head_cam_0", "head_cam_global")
    state, height, width = theirs.network(cameras, 2, brightest=255.0), *theirs.SIZE
    encoder = {"imagenet_norm": False, "crop_shape": [height - 4, width - 8]}
    changes: dict[str, Any] = {f"shape_meta.obs.{name}.shape": [height, width, 3] for name in cameras}
    changes |= {f"policy.obs_encoder.{key}": value for key, value in encoder.items()}
    path = theirs.write(tmp_path / "joint.ckpt", cameras, 2, state=state, **changes)
    seen = moments(("agent1", "agent2", "global"), 2)
    found = act_after(checkpoint(str(path), sampler="ddim", inference_steps=2), seen)
    agent_pos = torch.from_numpy(np.stack([each["commanded"].ravel() for each in seen]))
    given = {
        name: pictures_of(seen, camera, 255.0)[..., 2 : height - 2, 4 : width - 4]
        for name, camera in zip(cameras, ("agent1", "global"), strict=True)
    }
    scheduler = DDIMScheduler(**SCHEDULE)
    scheduler.set_timesteps(2)
    expected = theirs.actions(state, scheduler, given, agent_pos, noise(5), imagenet=False)
    assert np.abs(found.reshape(-1, 16) - expected.numpy()).max() < 1e-3


# -- in rollouts ---------------------------------------------------------------------------------------


class Recorder:
    """Policy that records its observations and adds 0.01 to the last commands."""

    observation_steps = 3

    def __init__(self) -> None:
        self.observations: list[dict[str, Any]] = []
        self.calls: list[int] = []

    def observe(self, observation: dict[str, Any]) -> None:
        self.observations.append(observation)

    def act(self, observation: dict[str, Any]) -> NDArray[np.float32]:
        self.calls.append(len(self.observations))
        return np.tile(observation["commanded"] + 0.01, (5, 1, 1))


class PuppetsWithCameras(Puppets):
    """Puppets with cameras."""

    cameras = ("agent1", "agent2", "global")

    def images(self, cameras: Any = None) -> dict[str, NDArray[np.uint8]]:
        self.taken = [*getattr(self, "taken", []), len(self.commands)]
        return {name: np.full((*theirs.SIZE, 3), 90, np.uint8) for name in self.cameras}


def judge(scene: Scene) -> Verdict:
    return Verdict(False, False, {})


def test_a_policy_of_several_observation_steps_receives_those_before_a_call() -> None:
    policy, world = Recorder(), PuppetsWithCameras(TWO)
    runner = ForeignRunner(SPEC, policy, TWO, FASTEST_RAD)
    rollout(world, judge, [runner], 7, 12)
    assert world.taken == [0, 3, 4, 5, 8, 9, 10] and policy.calls == [1, 4, 7]
    commanded = np.array(world.commands, np.float32)
    first = np.append(policy.observations[0]["qpos"][:, :7], np.ones((2, 1)), axis=1)
    assert np.array_equal(policy.observations[0]["commanded"], first)
    for step, each in zip(world.taken[1:], policy.observations[1:], strict=True):
        assert np.array_equal(each["commanded"], commanded[step - 1])


@pytest.mark.slow
def test_checkpoints_act_in_a_scene_and_name_what_does_not_fit(tmp_path: Path) -> None:
    path = str(theirs.write(tmp_path / "blind.ckpt", cameras=()))
    name, options = "rf_exp.policy.foreign.robofactory:checkpoint", {"paths": [path] * 2, "device": "cpu"}
    world = PuppetsWithCameras(TWO)
    rollout(world, judge, [ForeignRunner(SPEC, make_policy(name, options), TWO, FASTEST_RAD)], 7, 8)
    assert len(world.commands) == 8 and np.isfinite(world.commands).all()
    runner = ForeignRunner(SPEC, checkpoint(path), TWO, FASTEST_RAD)
    where = "policy 'theirs', scene 7, control step 0: the checkpoints command 1 arms, and the task has 2"
    with pytest.raises(StageError, match=where):
        rollout(PuppetsWithCameras(TWO), judge, [runner], 7, 8)
    with pytest.raises(StageError, match=r"several observation steps, which only foreign\.factory"):
        checkpoint(path).act(moments((), 1)[0])


def test_a_missing_camera_or_another_picture_size_is_named() -> None:
    (seen, *_) = moments(("agent2",), 1, (24, 32))
    with pytest.raises(StageError, match=r"camera 'agent1'; observed are rgb_agent2: set foreign\.obs"):
        picture(seen, "agent1", (24, 32))
    with pytest.raises(StageError, match=r"pictures 32 x 24, .*\{width: 48, height: 32\}"):
        picture(seen, "agent2", theirs.SIZE)


# -- files that are refused ----------------------------------------------------------------------------


class Runs:
    """Object that runs a command when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return os.system, (f"touch {self._mark}",)


@pytest.mark.parametrize("where", ["cfg", "pickles", "state_dicts"])
def test_a_file_that_names_code_is_refused_by_the_name_and_runs_nothing(where: str, tmp_path: Path) -> None:
    mark = tmp_path / "it_ran"
    saved: dict[str, Any] = {"cfg": {}, "state_dicts": {"model": {}}, "pickles": {}}
    saved[where] = {"a": Runs(mark)}
    torch.save(saved, tmp_path / "bad.ckpt")
    with pytest.raises(ArgumentError, match=r"bad.ckpt names posix.system, which is code"):
        read_policy(tmp_path / "bad.ckpt")
    assert not mark.exists()


def test_a_pickle_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.ckpt").write_bytes(pickle.dumps(Runs(tmp_path / "it_ran")))
    with pytest.raises(ArgumentError, match=r"expected the ZIP archive that torch.save writes"):
        read_policy(tmp_path / "bad.ckpt")
    assert not (tmp_path / "it_ran").exists()
    with pytest.raises(ArgumentError, match="there is no file"):
        read_policy(tmp_path / "none.ckpt")


def test_types_named_by_dill_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The release saves with dill, which names types by a function of its own."""

    def _load_type(name: str) -> Any: ...

    _load_type.__module__, _load_type.__qualname__ = "dill._dill", "_load_type"
    for name in ("dill", "dill._dill"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    sys.modules["dill._dill"]._load_type = _load_type  # pyright: ignore[reportAttributeAccessIssue]

    class Dict:
        def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
            return _load_type, ("dict",)

    torch.save({"type": Dict(), "x": [torch.arange(6.0).reshape(2, 3).T]}, tmp_path / "a.ckpt")
    file = Checkpoint(tmp_path / "a.ckpt")
    assert torch.equal(file.tensor(file.contents["x"][0]), torch.arange(6.0).reshape(2, 3).T)


def archive(saved: bytes, data: bytes = b"", compressed: bool = False) -> bytes:
    """A file in the format of torch.save, from a pickle and the data of one tensor."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED) as into:
        into.writestr("a/data.pkl", saved)
        into.writestr("a/data/0", data)
    return made.getvalue()


def small(**tensor: Any) -> bytes:
    """The pickle of a tensor (2, 3) with changed description: x + hexadecimal bytes -> other bytes."""
    made = io.BytesIO()
    torch.save({"x": torch.zeros(2, 3)}, made)
    with zipfile.ZipFile(made) as whole:
        saved = whole.read("archive/data.pkl")
    for old, new in tensor.items():
        saved = saved.replace(bytes.fromhex(old.removeprefix("x")), new)
    return saved


def test_tensors_that_are_longer_than_their_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.ckpt"
    sizes = "x4b024b0386"  # (2, 3)
    for content, message in (
        (archive(small(), bytes(20)), "20 bytes, not 6 numbers"),
        (archive(small(**{sizes: b"K\x02K\x04\x86"}), bytes(24)), "size .2, 4. .* of 6 numbers"),
        (archive(small(**{sizes: b"K\x02J\xff\xff\xff\xff\x86"}), bytes(24)), "size .2, -1."),
        (archive(small(), bytes(24), compressed=True), "is compressed"),
        (archive(small()[:40], bytes(24)), "is damaged"),
        (archive(b"", bytes(24)), "is damaged"),
    ):
        path.write_bytes(content)
        with pytest.raises(RfError, match=message):
            file = Checkpoint(path)
            file.tensor(file.contents["x"])


def test_a_damaged_file_is_an_error_that_names_it(tmp_path: Path) -> None:
    path = theirs.write(tmp_path / "bad.ckpt", cameras=())
    content = bytearray(path.read_bytes())
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(RfError, match=r"bad.ckpt"):
        read_policy(path)
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(StageError, match=r"bad.ckpt is damaged .*CRC"):
        read_policy(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"horizon": "${x}"}, "cfg.horizon is '.*'; expected int"),
        ({"policy.n_groups": 4}, "cfg.policy.n_groups"),
        ({"policy.obs_encoder.resize_shape": [10, 10]}, "resize_shape"),
        ({"policy.noise_scheduler._target_": "a.Other"}, "unknown sampler 'a.Other'|unknown sampler 'other'"),
        ({"policy.noise_scheduler.beta_schedule": "a"}, "noise_scheduler cannot be made"),
        ({"policy.noise_scheduler.more": 1}, "noise_scheduler cannot be made"),
        ({"shape_meta.obs.wrench": {"shape": [6], "type": "low_dim"}}, "shape_meta.obs.wrench"),
        (
            {"shape_meta.obs.front": {"shape": [3, 8, 8], "type": "rgb"}},
            "another network .*the file lacks it",
        ),
        ({"shape_meta.obs.front": {"shape": [3, 8], "type": "rgb"}}, r"shape_meta\.obs\.front\.shape"),
    ],
)
def test_a_checkpoint_of_another_kind_is_refused_by_its_key(
    changes: dict, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ArgumentError, match=message):
        read_policy(theirs.write(tmp_path / "a.ckpt", cameras=(), **changes))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (
            "model.mid_modules.0.blocks.0.block.0.bias",
            None,
            "middle.resnets.0.conv_in.conv1d.bias: the file lacks",
        ),
        ("model.mid_modules.1.cond_encoder.1.bias", None, "film.bias: the file has"),
        (
            "obs_encoder.key_model_map.head_cam.bn1.running_mean",
            (64,),
            "running_mean: .*the network lacks it",
        ),
        ("model.final_conv.1.bias", (7,), "predicts 7 numbers; expected 8 for each arm"),
        ("normalizer.params_dict.action.scale", (4,), r"action.scale: the file has \(4,\)"),
        ("model.final_conv.1.weight", "nan", "final_conv1d_2.weight is not finite"),
    ],
)
def test_a_network_of_another_kind_is_refused_by_its_tensor(
    name: str, change: Any, message: str, tmp_path: Path
) -> None:
    state = theirs.network((), 1)
    if change is None:
        del state[name]
    else:
        state[name] = state[name] * np.nan if change == "nan" else torch.full(change, 3.0)
    with pytest.raises(ArgumentError, match=message):
        read_policy(theirs.write(tmp_path / "a.ckpt", cameras=(), state=state))


# -- entries of the challenge --------------------------------------------------------------------------

ENTRY = """
import numpy as np
import beside

class DeployPolicy:
    def __init__(self, ckpt_path):
        self.path, self.seen = ckpt_path, []

    def reset(self):
        self.seen = []

    def update_obs(self, obs):
        self.seen.append(obs)

    def get_action(self):
        arms = self.seen[-1]["agent"]
        joints = [arms[f"panda-{k}"]["qpos"][0, :7].numpy() for k in range(2)]
        return [np.concatenate([np.append(each, beside.GRIPPER) for each in joints])] * 4
"""


@pytest.fixture
def entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("custom_policy", "checkpoints"):
        (tmp_path / name).mkdir()
    (tmp_path / "custom_policy/deploy_policy.py").write_text(ENTRY)
    (tmp_path / "custom_policy/beside.py").write_text("GRIPPER = -1.0")
    (tmp_path / "checkpoints/last.ckpt").write_text("")
    return tmp_path


def test_an_entry_receives_observations_in_the_format_of_the_challenge(entry: Path) -> None:
    policy = submission(str(entry), observation_steps=2)
    inner = policy._policy
    assert inner.path.endswith("checkpoints/last.ckpt")
    seen = moments(("agent1", "agent2", "global"), 2, (240, 320))
    chunk = act_after(policy, seen)
    assert chunk.shape == (4, 16) and (chunk[:, 7::8] == -1).all() and len(inner.seen) == 3
    received = inner.seen[-1]
    assert received["agent"]["panda-1"]["qpos"].shape == (1, 9)
    cameras = {"head_camera_agent0", "head_camera_agent1", "head_camera_global"}
    assert received["sensor_data"].keys() == cameras
    picture = received["sensor_data"]["head_camera_agent1"]["rgb"]
    assert picture.dtype == torch.uint8 and np.array_equal(picture[0], seen[-1]["rgb_agent2"])


def test_one_arm_has_no_number_and_cameras_have_their_calibration() -> None:
    (seen, *_) = moments(("agent1",), 1, (240, 320))
    pose = np.eye(4, dtype=np.float32)
    pose[:3, 3] = 1.0, 2.0, 3.0
    seen |= {"world_from_camera_agent1": pose, "intrinsics_agent1": np.eye(3, dtype=np.float32)}
    converted = as_maniskill(seen)
    assert converted["agent"]["qpos"].shape == (1, 9) and "head_camera" in converted["sensor_data"]
    parameters = converted["sensor_param"]["head_camera"]
    assert parameters["extrinsic_cv"][0, :, 3].tolist() == [-1, -2, -3]
    assert parameters["cam2world_gl"][0].diagonal().tolist() == [1, -1, -1, 1]
    with pytest.raises(StageError, match=r"\{width: 320, height: 240\}"):
        as_maniskill(moments(("agent1",), 1)[0])


def test_an_incomplete_entry_is_refused(entry: Path) -> None:
    (entry / "checkpoints/more.ckpt").write_text("")
    with pytest.raises(ArgumentError, match=r"checkpoints holds last.ckpt, more.ckpt; name one"):
        submission(str(entry))
    with pytest.raises(ArgumentError, match=r"there is no .*none.ckpt"):
        submission(str(entry), checkpoint=str(entry / "none.ckpt"))
    with pytest.raises(ArgumentError, match="observation_steps is 0"):
        submission(str(entry), str(entry / "checkpoints/last.ckpt"), 0)
    (entry / "custom_policy/deploy_policy.py").write_text("x = 1")
    with pytest.raises(ArgumentError, match="has no class DeployPolicy"):
        submission(str(entry), checkpoint=str(entry / "checkpoints/last.ckpt"))
    with pytest.raises(ArgumentError, match="expected the folder of a submission"):
        submission(str(entry / "checkpoints"))
