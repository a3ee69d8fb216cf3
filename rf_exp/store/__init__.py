"""The replay buffer: one Zarr 3 folder of demonstrations, written episode by episode.

    data/qpos (T, N, D) f32      measured joints: rad for the arm, metres for the two fingers
    data/qvel (T, N, D) f32      their velocities
    data/action (T, N, A) f32    joint targets in rad + gripper command, as intended
    data/executed (T, N, A) f32  executed commands, in a store of disturbed demonstrations
    data/rgb_<camera> (T, H, W, 3) u8
    data/depth_<camera> (T, H, W) u16         mm along the viewing direction, 0: no surface; optional
    data/segmentation_<camera> (T, H, W) u8   index into the attribute `labels`; optional
    data/pose_<object> (T, 7) f32  position in m and quaternion w, x, y, z, world frame
    data/time_s (T,) f64           since the start of the episode
    data/condition_{value,bound} (T, C) f32, data/condition_unit (T, C) u8, data/condition_holds (T, C) bool
                                   the C conditions of success, evaluated after each action
    data/subgoal (T, N) i16      current subgoal of each agent: index into its texts in the certificate's
                                 `subgoals`; -1: unknown
    meta/episode_ends (E,) i64   row after the last of each episode
    meta/seed (E,) i64, meta/certificate (E,) JSON text

An episode is committed by its entry in `episode_ends`, which is written last: an interruption before
leaves surplus rows that readers ignore and the next writer cuts off. Every file is replaced
atomically, so a killed process never damages stored episodes.

Pictures are compressed with plain zstd, 8 frames a chunk. The cameras stand still, so most of a
frame repeats the one before it, and zstd sees that when frames share a chunk; Blosc cuts chunks
into blocks too small for it. States are compressed 128 rows a chunk, so that damage costs few episodes.

Attributes of arrays: dimensions, names, units and frame. Attributes of the store: the task in words, the
conditions of success, cameras and robots (`Description`), and provenance. docs/data.md shows them all.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
