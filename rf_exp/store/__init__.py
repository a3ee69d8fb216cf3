"""The replay buffer: one Zarr 3 folder of demonstrations, written episode by episode.

    data/qpos (T, N, D) f32      measured joints: rad for the arm, metres for the two fingers
    data/qvel (T, N, D) f32      their velocities
    data/action (T, N, A) f32    joint targets in rad + gripper command, as intended
    data/executed (T, N, A) f32  what the arms were told, in a store of disturbed demonstrations
    data/rgb_<camera> (T, H, W, 3) u8
    data/depth_<camera> (T, H, W) u16         mm along the viewing direction, 0 is nothing; if asked for
    data/segmentation_<camera> (T, H, W) u8   index of the attribute `labels`; if asked for
    data/pose_<object> (T, 7) f32  position in m and quaternion w, x, y, z, world frame
    data/time_s (T,) f64           since the start of the episode
    data/condition_{value,bound} (T, C) f32, data/condition_unit (T, C) u8, data/condition_holds (T, C) bool
                                   the C conditions of success, judged on what each action has led to
    data/subgoal (T, N) i16      what each agent is about: an index of its texts in the certificate's
                                 `subgoals`; -1 where that is not known
    meta/episode_ends (E,) i64   row after the last of each episode
    meta/seed (E,) i64, meta/certificate (E,) JSON text

An episode counts once `episode_ends` names it, and that is written last: whatever happens before
leaves surplus rows that readers ignore and the next writer cuts off. Every file is replaced
atomically, so a killed process never damages what was stored.

Pictures are compressed with plain zstd, 8 frames a chunk. The cameras stand still, so most of a
frame repeats the one before it, and zstd sees that when frames share a chunk; Blosc cuts chunks
into blocks too small for it. States are compressed 128 rows a chunk, so that damage costs few episodes.

Attributes say the rest: of each array its dimensions, names, units and frame; of the store the task in words,
the conditions of success, cameras and robots (`Description`), and what made it. docs/data.md shows them all.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
