"""Contacts: grasps, and contacts between arms and with clutter, read from PhysX's contact list."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import sapien
from numpy.typing import NDArray
from sapien import physx

from rf_exp.robots import Hand

GRASP_FORCE_N = 0.5  # on each finger, ManiSkill's is_grasping
GRASP_ANGLE_DEG = 85.0  # between that force and the direction the finger opens in

Vector = NDArray[np.float64]


class Contacts:
    """Contact reader for one scene: maps bodies to the arms, objects and clutter that they belong to."""

    def __init__(
        self,
        robots: Sequence[physx.PhysxArticulation],
        hands: Sequence[Hand],
        objects: Mapping[str, sapien.Entity],
        clutter: Mapping[str, sapien.Entity] = MappingProxyType({}),
    ) -> None:
        # SAPIEN returns the same Python object for a body while a reference is kept: these maps keep one.
        self._agent_of: dict[physx.PhysxRigidBaseComponent, int] = {
            link: agent for agent, robot in enumerate(robots, 1) for link in robot.links
        }
        self._fingers = [
            [
                next(link for link in robot.links if link.name.endswith(finger_spec.link))
                for finger_spec in hand.fingers
            ]
            for robot, hand in zip(robots, hands, strict=True)
        ]
        self._opening_directions = {
            link: np.array(finger.opens)
            for arm_fingers, hand in zip(self._fingers, hands, strict=True)
            for link, finger in zip(arm_fingers, hand.fingers, strict=True)
        }
        self._object_of = _body_names(objects)
        self._clutter_of = _body_names(clutter)
        self._mover_of = {link: f"agent{agent}" for link, agent in self._agent_of.items()} | self._object_of

    def finger_contacts(
        self, contacts: Sequence[physx.PhysxContact], timestep_s: float
    ) -> tuple[tuple[str | None, ...], dict[tuple[int, str], Vector]]:
        """The object grasped by each arm, or None, and (agent, object) -> the force (3,) in N with which the
        fingers push it, world frame."""
        on_finger: dict[tuple, Vector] = defaultdict(lambda: np.zeros(3))  # N, world frame
        for contact in contacts:
            a, b = contact.bodies
            if a in self._opening_directions and b in self._object_of:
                on_finger[a, self._object_of[b]] += _impulse(contact) / timestep_s
            elif b in self._opening_directions and a in self._object_of:
                on_finger[b, self._object_of[a]] -= _impulse(contact) / timestep_s
        pushes: dict[tuple[int, str], Vector] = defaultdict(lambda: np.zeros(3))
        for (finger, name), force in on_finger.items():
            pushes[self._agent_of[finger], name] -= force
        return tuple(self._held_object(fingers, on_finger) for fingers in self._fingers), dict(pushes)

    def arm_contacts(
        self, contacts: Sequence[physx.PhysxContact], timestep_s: float
    ) -> dict[tuple[int, int], float]:
        """(agent, agent) -> contact force between the two arms in N, the lower agent first."""
        forces: dict[tuple[int, int], float] = defaultdict(float)
        for contact in contacts:
            a, b = (self._agent_of.get(body) for body in contact.bodies)
            if a is not None and b is not None and a != b:
                impulse = sum(float(np.linalg.norm(point.impulse)) for point in contact.points)
                forces[min(a, b), max(a, b)] += impulse / timestep_s
        return {pair: force for pair, force in forces.items() if force > 0}

    def clutter_contacts(
        self, contacts: Sequence[physx.PhysxContact], timestep_s: float
    ) -> dict[tuple[str, str], float]:
        """(agent<k> or object, piece of clutter) -> contact force between them in N."""
        forces: dict[tuple[str, str], float] = defaultdict(float)
        for contact in contacts if self._clutter_of else ():
            for body, other in (contact.bodies, contact.bodies[::-1]):
                if body in self._mover_of and other in self._clutter_of:
                    impulse = sum(float(np.linalg.norm(point.impulse)) for point in contact.points)
                    forces[self._mover_of[body], self._clutter_of[other]] += impulse / timestep_s
        return {pair: force for pair, force in forces.items() if force > 0}

    def _held_object(self, fingers: Sequence, on_finger: Mapping[tuple, Vector]) -> str | None:
        """The object that presses both fingers of an arm apart, or None; of several, the hardest pressed."""
        pinched = {}
        first, second = fingers
        for (finger, name), force in on_finger.items():
            opposite = on_finger.get((second, name)) if finger is first else None
            if (
                opposite is not None
                and self._pushes_open(first, force)
                and self._pushes_open(second, opposite)
            ):
                pinched[name] = float(np.linalg.norm(force) + np.linalg.norm(opposite))
        return max(pinched, key=pinched.__getitem__, default=None)

    def _pushes_open(self, finger: physx.PhysxArticulationLinkComponent, force_n: Vector) -> bool:
        """Whether the force on the finger exceeds the threshold and points in its opening direction."""
        size = float(np.linalg.norm(force_n))
        if size < GRASP_FORCE_N:
            return False
        opening = finger.entity_pose.to_transformation_matrix()[:3, :3] @ self._opening_directions[finger]
        return float(opening @ force_n) >= size * np.cos(np.deg2rad(GRASP_ANGLE_DEG))


def _body_names(entities: Mapping[str, sapien.Entity]) -> dict[Any, str]:
    return {
        entity.find_component_by_type(physx.PhysxRigidBaseComponent): name
        for name, entity in entities.items()
    }


def _impulse(contact: physx.PhysxContact) -> Vector:
    """Impulse (3,) in N s of the second body on the first."""
    total = np.zeros(3)
    for point in contact.points:  # np.sum takes several times as long for so few
        total += point.impulse
    return total
