"""Laws of the four architectures, and the configuration files that name them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.errors import ArgumentError
from rf_exp.policy import Stream, View, views
from rf_exp.types import Arch
from tests.policy.conftest import ARCHS

CONF = Path(__file__).parents[2] / "conf"
AGENTS = range(1, 5)


@pytest.mark.parametrize("agents", AGENTS)
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_every_agent_is_commanded_once(arch: Arch, agents: int) -> None:
    commanded = [agent for view in views(arch, agents) for agent in view.agents]
    assert sorted(commanded) == list(range(1, agents + 1))


@pytest.mark.parametrize("agents", AGENTS)
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_cameras_and_sizes_follow_the_architecture(arch: Arch, agents: int) -> None:
    found = views(arch, agents)
    assert len(found) == (1 if arch.shared_policy else agents)
    assert len({view.name for view in found}) == len(found)
    joint = arch.shared_policy and arch.global_view
    for view in found:
        assert view.action_size == view.proprio_size == 8 * (agents if joint else 1)
        for stream in view.streams:
            expected = "global" if arch.global_view else f"agent{stream.agents[0]}"
            assert stream.camera == expected


def test_the_four_architectures_for_two_agents() -> None:
    joint, shared, separate_global, local = (views(arch, 2) for arch in ARCHS)
    one, two = Stream("agent1", (1,)), Stream("agent2", (2,))
    assert joint == (View("joint", (Stream("global", (1, 2)),)),)
    assert shared == (View("shared", (one, two)),)
    assert separate_global == (
        View("agent1", (Stream("global", (1,)),)),
        View("agent2", (Stream("global", (2,)),)),
    )
    assert local == (View("agent1", (one,)), View("agent2", (two,)))


def test_no_agents_is_an_error() -> None:
    with pytest.raises(ArgumentError, match="agents is 0; expected at least 1"):
        views(ARCHS[0], 0)


@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_the_configuration_file_says_the_same(arch: Arch) -> None:
    node = OmegaConf.to_container(OmegaConf.load(CONF / "arch" / f"{arch.name}.yaml"))
    assert node == {arch.name: {"shared_policy": arch.shared_policy, "global_view": arch.global_view}}


def test_separate_coordinated_is_separate_local_with_coordination() -> None:
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "arch" / "separate_coordinated.yaml"))
    coordinated = views(Arch("separate_coordinated", **node["separate_coordinated"]), 3)
    assert all(view.coordinated for view in coordinated)
    assert tuple(replace(view, coordinated=False) for view in coordinated) == views(ARCHS[3], 3)


def test_both_views_are_side_by_side_in_one_stream() -> None:
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "arch" / "separate_both.yaml"))
    both = Arch("separate_both", **node["separate_both"])
    assert views(both, 2) == (
        View("agent1", (Stream("agent1", (1,), ("global",)),)),
        View("agent2", (Stream("agent2", (2,), ("global",)),)),
    )
    assert views(both, 2)[0].identity["streams"] == [
        {"camera": "agent1", "agents": (1,), "more": ("global",)}
    ]
    (joint,) = views(replace(both, shared_policy=True, global_view=True), 3)
    assert joint.streams == (Stream("global", (1, 2, 3), ("agent1", "agent2", "agent3")),)


@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_identities_of_the_paper_s_architectures_have_no_other_keys(arch: Arch) -> None:
    """So identities of policies stay as they were before there were other architectures."""
    for view in views(arch, 2):
        streams = [{"camera": stream.camera, "agents": stream.agents} for stream in view.streams]
        assert view.identity == {"name": view.name, "streams": streams}


def test_arch_all_selects_the_four_architectures() -> None:
    with initialize_config_dir(str(CONF / "arch"), version_base=None):
        found = OmegaConf.to_container(compose("all"))
    assert isinstance(found, dict)
    assert found.keys() == {arch.name for arch in ARCHS}
