"""Camera names of the authors' release.

The release numbers agents from 0, this package from 1; with a single arm its camera has no number.
"""

import re

_THEIRS = re.compile(r"(head|hand)_cam(?:era)?_(?:agent)?(\d{1,2})")
_OURS = re.compile(r"(agent|hand)([1-9]\d?)")
_GLOBAL = "head_camera_global"


def camera_of(name: str, agents: int) -> str:
    """Our name of a camera of the release; other names are unchanged."""
    if name in ("head_camera", "head_cam"):
        return "agent1" if agents == 1 else "global"  # one camera for all agents
    if name in (_GLOBAL, "head_cam_global"):
        return "global"
    found = _THEIRS.fullmatch(name)
    return f"{'agent' if found[1] == 'head' else 'hand'}{int(found[2]) + 1}" if found else name


def camera_name(camera: str, agents: int) -> str:
    """The release's name of one of our cameras; other names are unchanged."""
    if camera == "global":
        return _GLOBAL
    if camera == "agent1" and agents == 1:
        return "head_camera"
    found = _OURS.fullmatch(camera)
    if found is None:
        return camera
    return f"{'head_camera_agent' if found[1] == 'agent' else 'hand_camera_'}{int(found[2]) - 1}"
