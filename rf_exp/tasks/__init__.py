"""Tasks and their assets: geometry, plans and success criteria. Knows no simulator."""

from rf_exp.tasks.base import CameraSpec, Judge, ObjectSpec, Randomisation, RobotSpec, Start, Task

__all__ = ["CameraSpec", "Judge", "ObjectSpec", "Randomisation", "RobotSpec", "Start", "Task"]
