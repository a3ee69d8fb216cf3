"""Shading normals and colours."""

import numpy as np
import trimesh

from rf_exp import viz
from rf_exp.viz import HOLDS, VIOLATED
from rf_exp.viz.elements import creased, srgb


def test_boxes_keep_sharp_edges_and_balls_stay_smooth():
    shape = trimesh.creation.box((1.0, 2.0, 3.0))
    indices, normals, faces = creased(shape.vertices, shape.faces)
    assert len(indices) == 24  # each corner once per adjacent side
    corners = shape.vertices[indices][faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(normals[faces], np.repeat(outward[:, None], 3, axis=1), atol=1e-9)

    ball = trimesh.creation.icosphere(subdivisions=3)
    indices, normals, faces = creased(ball.vertices, ball.faces)
    assert len(indices) == len(ball.vertices)
    np.testing.assert_allclose(normals, ball.vertices[indices], atol=0.02)
    np.testing.assert_array_equal(ball.vertices[indices][faces], ball.vertices[ball.faces])


def test_linear_values_become_srgb():
    assert srgb((0.0, 0.2140, 1.0)).tolist() == [0, 127, 255]  # middle grey


def test_colours_of_agents_differ_from_each_other_and_from_verdicts():
    colours = np.array([*(viz.agent_colour(agent) for agent in range(1, 5)), VIOLATED, HOLDS], dtype=float)
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=-1) + 1e3 * np.eye(len(colours))
    assert distances.min() > 50
