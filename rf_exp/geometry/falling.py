"""Rest pose of an object dropped into another: straight below, on the part there."""

from collections.abc import Mapping

from shapely import MultiPoint, Point

from rf_exp.tasks import Task
from rf_exp.transforms import Matrix, apply
from rf_exp.types import Subgoal


def pose_after_drop(task: Task, subgoal: Subgoal, pose: Matrix, poses: Mapping[str, Matrix]) -> Matrix:
    """world_from_object (4, 4) of the object that a subgoal releases at a pose, after its fall.

    The pose itself unless the subgoal drops the object into another one, with its pose in `poses`, that is
    below. The object keeps its orientation, and comes to rest on the highest part below its origin.
    """
    name, target = subgoal.object or "", subgoal.target or ""
    if subgoal.verb != "place" or target not in task.objects:
        return pose
    placing = task.asset(target).placement_points
    point = placing.get(subgoal.target_point or next(iter(placing), ""))
    if point is None or point.kind != "drop":
        return pose
    x_m, y_m = pose[:2, 3]
    parts = (apply(poses[target], hull.vertices) for hull in task.asset(target).hulls)
    below = [part for part in parts if MultiPoint(part[:, :2]).convex_hull.covers(Point(x_m, y_m))]
    if not below:
        return pose
    floor_m = max(float(part[:, 2].max()) for part in below)
    rest_pose = pose.copy()
    rest_pose[2, 3] -= max(0.0, float(task.asset(name).vertices(pose)[:, 2].min()) - floor_m)
    return rest_pose
