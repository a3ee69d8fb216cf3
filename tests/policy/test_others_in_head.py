"""Others in the head: what other agents do may decide when an agent goes on, and not how."""

import numpy as np
import pytest
import torch
from torch import Tensor

from rf_exp.errors import ArgumentError
from rf_exp.policy import Policy, PolicyConfig, Windows, views
from rf_exp.policy.networks.keypoint_encoder import OUT
from rf_exp.types import Arch
from tests.policy.conftest import ARCHS, varied

CPU = torch.device("cpu")


def phased(config: PolicyConfig, others_in_head: bool) -> PolicyConfig:
    changes = {"encoder.name": "keypoints", "context": True, "crop": 1.0, "observation_steps": 1}
    return varied(config, {**changes, "phases": True, "horizon": 8, "others_in_head": others_in_head})


@pytest.mark.parametrize("others_in_head", [True, False])
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_what_others_do_says_when_to_go_on_and_the_head_is_told_only_if_it_shall_be(
    make_store, policy_config: PolicyConfig, arch: Arch, others_in_head: bool
) -> None:
    config = phased(policy_config, others_in_head)
    view = views(arch, 2)[0]
    windows = Windows(make_store(2, 2), view, config, CPU)
    torch.manual_seed(0)
    policy, spec = Policy(config, view, windows.spec).eval(), windows.spec
    batch = windows.batch(np.arange(2), None)
    seen = torch.randn(2, 1, policy.encoder.features)
    own = len(view.streams[0].agents) * (spec.keyframes + 2) * OUT  # at keyframes, and now
    mine, theirs = seen.clone(), seen.clone()
    mine[..., :own] += 1
    theirs[..., own:] += 1

    def act(features: Tensor) -> Tensor:
        generators = [torch.Generator().manual_seed(k) for k in range(2)]
        return policy.act(features, batch.proprio, batch.context, generators)

    def chances(features: Tensor) -> Tensor:
        found = policy.chances(features, batch.proprio, batch.context)
        assert found is not None
        return found

    alone = len(view.streams[0].agents) == len(spec.bases)  # one policy commands all arms
    assert torch.equal(act(seen), act(theirs)) is (alone or not others_in_head)
    assert torch.equal(chances(seen), chances(theirs)) is alone
    assert not torch.equal(act(seen), act(mine)) and not torch.equal(chances(seen), chances(mine))


@pytest.mark.parametrize("otherwise", [{"phases": False}, {"encoder.name": "compact"}])
def test_the_head_has_to_be_told_where_nothing_else_is_or_it_cannot_be_left_out(
    policy_config: PolicyConfig, otherwise: dict[str, object]
) -> None:
    changes = {"encoder.name": "keypoints", "context": True, "crop": 1.0, "phases": True, "horizon": 8}
    expected = "others_in_head is False; expected true but with phases and encoder keypoints"
    with pytest.raises(ArgumentError, match=expected):
        varied(policy_config, {**changes, "observation_steps": 1, "others_in_head": False, **otherwise})
