"""Which measured arms touch: contact forces, and volumes that overlap."""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Unpack

from rf_exp.constraints.evidence import Evidence
from rf_exp.findings import About, Finding
from rf_exp.geometry import PlanningScene, Swept, overlap
from rf_exp.tasks import Task
from rf_exp.types import Scene

CONTACT_N = 1.0  # force between two arms that counts as contact


def touching(
    task: Task,
    scene: Scene,
    pairs: tuple[tuple[int, int], ...],
    may_touch: Mapping[int, frozenset[str]] | None = None,
) -> Evidence | None:
    """The first pair of arms that touch: contact force from the simulator, or overlapping volume."""
    return pressing(scene, pairs) or overlapping(task, scene, pairs, may_touch)


def pressing(scene: Scene, pairs: tuple[tuple[int, int], ...]) -> Evidence | None:
    """The first pair of arms that the simulator sees press on one another."""
    for a, b, force_n in scene.arm_contacts:
        if tuple(sorted((a, b))) in pairs and force_n > CONTACT_N:
            return _found(scene, Finding.TOUCHING, force_n, CONTACT_N, "N", agents=(a, b))
    return None


def overlapping(
    task: Task,
    scene: Scene,
    pairs: tuple[tuple[int, int], ...],
    may_touch: Mapping[int, frozenset[str]] | None = None,
) -> Evidence | None:
    """The first pair of arms whose exact volumes overlap, whatever the simulator says.

    What an arm holds is part of it, where it was measured. `may_touch` (agent -> objects) names what the
    gripper of an agent, and what it holds, may touch in the hands of another one.
    """
    for (a, b), bodies in zip(pairs, measured_arms(task, scene, pairs, may_touch or {}), strict=True):
        gap = overlap(*bodies)
        if gap is not None:
            return _found(scene, Finding.OVERLAPPING, gap.distance_m, agents=(a, b), parts=(gap.a, gap.b))
    return None


def _found(
    scene: Scene, finding: Finding, value: float, bound: float = 0.0, unit: str = "", **about: Unpack[About]
) -> Evidence:
    facts: About = {"measured": True, **about}
    return Evidence(
        ok=False, finding=finding, value=value, bound=bound, unit=unit, time_s=scene.time_s, **facts
    )


def measured_arms(
    task: Task,
    scene: Scene,
    pairs: tuple[tuple[int, int], ...],
    may_touch: Mapping[int, frozenset[str]],
) -> Iterator[tuple[Swept, Swept]]:
    """Pairs of measured arms, each with what it holds."""
    planning_scene = PlanningScene(task, scene)

    @cache
    def body(agent: int, load: str | None) -> Swept:
        return planning_scene.measured(agent, attached=load, touches=may_touch.get(agent, frozenset()))

    for a, b in pairs:
        loads = scene.held[a - 1], scene.held[b - 1]
        if loads[0] == loads[1]:  # what two hold together is no obstacle between them
            loads = None, None
        yield body(a, loads[0]), body(b, loads[1])
