"""What the authors' release calls its cameras.

They count from 0, where agents here count from 1; where there is one arm its camera has no number.
"""

import re

_THEIRS = re.compile(r"(head|hand)_cam(?:era)?_(?:agent)?(\d{1,2})")
_OURS = re.compile(r"(agent|hand)([1-9]\d?)")
_GLOBAL = "head_camera_global"


def camera_of(name: str, agents: int) -> str:
    """What a camera of the release is called here; a name of another kind stays."""
    if name in ("head_camera", "head_cam"):
        return "agent1" if agents == 1 else "global"  # one that serves all
    if name in (_GLOBAL, "head_cam_global"):
        return "global"
    found = _THEIRS.fullmatch(name)
    return f"{'agent' if found[1] == 'head' else 'hand'}{int(found[2]) + 1}" if found else name


def camera_name(camera: str, agents: int) -> str:
    """What the release calls a camera of ours."""
    if camera == "global":
        return _GLOBAL
    if camera == "agent1" and agents == 1:
        return "head_camera"
    found = _OURS.fullmatch(camera)
    if found is None:
        return camera
    return f"{'head_camera_agent' if found[1] == 'agent' else 'hand_camera_'}{int(found[2]) - 1}"
