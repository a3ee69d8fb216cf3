"""Forward kinematics against Pinocchio, and inverse against forward kinematics."""

import numpy as np
import pinocchio as pin
import pytest

from rf_exp.robots import DEFAULT, Arm
from rf_exp.transforms import inverse, planar


def random_qpos(rng, count):
    low, high = DEFAULT.limits_rad
    return np.hstack([rng.uniform(low, high, (count, 7)), rng.uniform(0, 0.04, (count, 2))])


def test_vectorised_kinematics_equal_pinocchio():
    model = pin.buildModelFromUrdf(str(DEFAULT.urdf_path))
    data = model.createData()
    qpos = random_qpos(np.random.default_rng(0), 20)
    links, tcps = DEFAULT.link_poses(qpos), DEFAULT.tcp_pose(qpos[:, :7])
    for i, q in enumerate(qpos):
        pin.framesForwardKinematics(model, data, q)
        for j, name in enumerate(DEFAULT.links):
            np.testing.assert_allclose(links[i, j], data.oMf[model.getFrameId(name)].homogeneous, atol=1e-12)
        np.testing.assert_allclose(
            tcps[i], data.oMf[model.getFrameId(DEFAULT.hand.tcp)].homogeneous, atol=1e-12
        )


def test_solutions_reach_the_requested_pose():
    arm = Arm(DEFAULT, planar(0.3, -0.75, np.pi / 2))
    rng = np.random.default_rng(1)
    solved = 0
    for q in random_qpos(rng, 100)[:, :7] * 0.9:
        goal = arm.tcp(q)
        solution = arm.solve(goal, q + rng.normal(0, 0.3, 7))
        if solution is None:
            continue
        solved += 1
        assert np.linalg.norm(arm.tcp(solution)[:3, 3] - goal[:3, 3]) < 2e-4
        assert np.linalg.norm(pin.log3((inverse(arm.tcp(solution)) @ goal)[:3, :3])) < 2e-4
        low, high = DEFAULT.limits_rad
        assert (solution > low).all() and (solution < high).all()
    assert solved > 60


def test_solve_returns_none_out_of_reach():
    assert Arm(DEFAULT, np.eye(4)).solve(planar(2.0, 0.0, 0.0, 0.3), np.array(DEFAULT.rest_rad)) is None


@pytest.mark.parametrize("link", DEFAULT.links)
def test_hulls_are_convex_and_of_the_size_of_a_link(link):
    hull = DEFAULT.hulls[link]
    assert hull.is_convex and hull.is_watertight
    assert 0.02 < hull.extents.max() < 0.4


def test_neighbouring_links_are_not_checked_for_self_collision():
    assert (0, 1) not in DEFAULT.self_pairs
    assert (2, DEFAULT.links.index("panda_hand")) in DEFAULT.self_pairs
