"""Whether demonstrations hold what they should: every byte is read, and what it says is judged."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.store.integrity import Damage
from rf_exp.store.store import Store

UNIT_WITHIN = 1e-3  # of the length of quaternions


def problems(store: Store, index: int) -> list[str]:
    """What is wrong with one episode, in words; nothing for one that is whole. Reads all of it."""
    try:
        episode = store.episode(index)
    except Damage as error:
        return [str(error)]
    floats: dict[str, NDArray[Any]] = {
        "qpos": episode.qpos,
        "qvel": episode.qvel,
        "action": episode.action,
        "executed": episode.commanded,
        **{f"pose_{name}": poses for name, poses in episode.poses.items()},
    }
    found = [
        f"{name} holds values that are not finite" for name, x in floats.items() if not np.isfinite(x).all()
    ]
    found += [
        f"pose_{name} has quaternions that are not of unit length"
        for name, poses in episode.poses.items()
        if (np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) > UNIT_WITHIN).any()
    ]
    found += [
        f"camera {camera} shows nothing: one colour in every picture"
        for camera, pictures in episode.images.items()
        if (pictures == pictures[0, 0, 0]).all()
    ]
    texts: Any = episode.certificate.get("subgoals")
    if episode.subgoal is not None and texts is not None:
        most = np.array([len(of_agent) for of_agent in texts])
        if (episode.subgoal < -1).any() or (episode.subgoal >= np.maximum(most, 1)).any():
            found.append(f"subgoal has numbers that its certificate has no text for: {most.tolist()} texts")
    if episode.judged is not None and not episode.judged.holds[-1].all():
        missing = np.array(episode.judged.names)[~episode.judged.holds[-1]].tolist()
        found.append(f"it ends without success: not {', not '.join(missing)}")
    return [f"episode {index}, seed {episode.seed}: {what}" for what in found]
