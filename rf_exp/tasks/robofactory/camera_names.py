"""Camera names of the authors' release.

The release numbers agents from 0, this package from 1; with a single arm its camera has no number.
"""

import re

_RELEASE_NAME = re.compile(r"(head|hand)_cam(?:era)?_(?:agent)?(\d{1,2})")
_NAME = re.compile(r"(agent|hand)([1-9]\d?)")
_GLOBAL = "head_camera_global"


def camera_from_release(name: str, agents: int) -> str:
    """Our name of a camera of the release; other names are unchanged."""
    if name in ("head_camera", "head_cam"):
        return "agent1" if agents == 1 else "global"  # one camera for all agents
    if name in (_GLOBAL, "head_cam_global"):
        return "global"
    match = _RELEASE_NAME.fullmatch(name)
    return f"{'agent' if match[1] == 'head' else 'hand'}{int(match[2]) + 1}" if match else name


def camera_to_release(camera: str, agents: int) -> str:
    """The release's name of one of our cameras; other names are unchanged."""
    if camera == "global":
        return _GLOBAL
    if camera == "agent1" and agents == 1:
        return "head_camera"
    match = _NAME.fullmatch(camera)
    if match is None:
        return camera
    return f"{'head_camera_agent' if match[1] == 'agent' else 'hand_camera_'}{int(match[2]) - 1}"
