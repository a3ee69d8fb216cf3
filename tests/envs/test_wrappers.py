"""Gymnasium's wrappers around the environments, as docs/environments.md describes for films."""

import gymnasium
import imageio_ffmpeg
import pytest
from gymnasium.wrappers import RecordEpisodeStatistics, RecordVideo

import rf_exp.envs
from rf_exp.types import CONTROL_HZ

LIMIT = 4  # control steps


@pytest.mark.render
@pytest.mark.slow
def test_every_episode_is_filmed(tmp_path) -> None:
    pytest.importorskip("moviepy", reason="Gymnasium's RecordVideo writes with it: the extra envs")
    size = rf_exp.envs.Observations(width=64, height=48)
    env = gymnasium.make("rf_exp/pick_meat-v1", observations=size, render_mode="rgb_array", step_limit=LIMIT)
    env = RecordEpisodeStatistics(RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True))
    for seed in range(2):
        env.reset(seed=seed)
        for _ in range(LIMIT):
            *_, truncated, info = env.step(env.action_space.sample())
        assert truncated and info["episode"]["l"] == LIMIT
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "rl-video-episode-0.mp4",
        "rl-video-episode-1.mp4",
    ]
    for path in tmp_path.iterdir():
        reader = imageio_ffmpeg.read_frames(str(path))
        metadata = next(reader)
        assert (metadata["size"], metadata["fps"]) == ((64, 48), CONTROL_HZ)
        assert len(list(reader)) == LIMIT + 1


@pytest.mark.slow
def test_the_recorder_of_maniskill_is_not_supported(tmp_path) -> None:
    """As documented; if this fails, update the documents."""
    from mani_skill.utils.wrappers import RecordEpisode

    env = gymnasium.make("rf_exp/pick_meat-v1")
    with pytest.raises(AttributeError, match="num_envs"):
        RecordEpisode(env, str(tmp_path), save_video=False)  # pyright: ignore[reportArgumentType]
    env.close()
