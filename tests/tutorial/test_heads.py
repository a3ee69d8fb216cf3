"""Policy heads from outside, each one file and one recipe, are trained, saved, loaded, and give commands."""

import pytest

from tests.tutorial.test_additions import run

TRAINS = """
    from dataclasses import replace
    from pathlib import Path
    import tempfile
    import numpy as np
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf
    from rf_exp.command import register_all_tasks
    from rf_exp.errors import ArgumentError, StageError
    from rf_exp.experiment import read_experiment
    from rf_exp.keys.known import known_keys, unknown_keys
    from rf_exp.policy import DiffusionRunner, import_code, load_policy, train, views
    from rf_exp.store import Store
    from tests.conftest import CONF
    from tests.policy.conftest import ARCHS, HEIGHT, WIDTH, make_episode, rows, scene_at, shown, write_store

    register_all_tasks()
    small = ["policy.encoder.keypoints.steps=2", "training.steps=4", "training.batch_size=8"]
    small += ["training.device=cpu", "training.log_every=1", f"picture={{width: WIDTH, height: HEIGHT}}"]
    folder = f"hydra.searchpath=[file://{CONF.parent}/tests/tutorial/conf]"
    with initialize_config_dir(str(CONF), version_base="1.3"):
        node = compose("config", ["recipe=test", folder, "policy=NAME", *small])
        node = OmegaConf.to_container(node, resolve=True)
    import_code(node["policy"])
    assert not list(unknown_keys(node, known_keys(node, {})))
    node["policy"]["head"]["NAME"]["stepz"] = 3
    assert list(unknown_keys(node, known_keys(node, {}))) == ["policy.head.NAME.stepz"]
    del node["policy"]["head"]["NAME"]["stepz"]
    asked = read_experiment(node)
    out = Path(tempfile.mkdtemp())
    view, store = views(ARCHS[-1], 2)[0], Store.open(write_store(out / "reach.zarr", 2, 2))
    made = train(store, view, asked.policy, asked.training, out / "policy")
    assert [int(row["step"]) for row in rows(made)] == [1, 2, 3, 4, 5, 6]
    policy, *known_of_it = load_policy(made, "cpu")
    assert policy.config == asked.policy and policy.transitions is not None
    runner, episode = DiffusionRunner(policy, *known_of_it), make_episode(9, 2)
    commands = []
    for _ in range(2):
        runner.reset(9)
        pictures = {camera: frames[0] for camera, frames in episode.images.items()}
        commands.append(runner(shown(runner, scene_at(episode, 0), pictures)))
    assert commands[0].shape == (1, 8) and np.array_equal(*commands)
    print(made)
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flow_matching", "act"])
def test_a_head_from_outside_is_trained_and_gives_commands(name: str) -> None:
    size = "picture={width: 48, height: 32}"
    code = TRAINS.replace('f"picture={{width: WIDTH, height: HEIGHT}}"', repr(size)).replace("NAME", name)
    folder = run(code).strip()
    output = run(
        f"""
        from rf_exp.errors import StageError
        from rf_exp.policy import load_policy
        try:
            load_policy(__import__("pathlib").Path({folder!r}), "cpu")
        except StageError as error:
            print(error)
        """
    )
    assert f"unknown head {name!r}; available: diffusion, refined, regression" in output
