"""Every file of conf/ composes to a valid experiment; `all` means all of a group."""

from dataclasses import MISSING, fields, is_dataclass, replace
from itertools import product
from typing import Any, get_args, get_type_hints

import pytest
import yaml

from rf_exp.command import CONF
from rf_exp.datagen import Settings
from rf_exp.experiment import Experiment
from rf_exp.observations import Observations
from rf_exp.policy import TrainConfig
from rf_exp.robots import Robot
from rf_exp.tasks import CameraSpec, ObjectSpec, RobotSpec, Task, Variation
from rf_exp.tasks.task.clutter import Clutter
from rf_exp.types import Arch, ConstraintSet
from tests.conftest import experiment

GROUPS = {
    group: sorted(
        str(path.relative_to(CONF / group).with_suffix("")) for path in (CONF / group).rglob("*.yaml")
    )
    for group in ("task", "arch", "constraints", "policy", "profile", "experiment", "brain")
}


def read_choice(group: str, name: str) -> dict[str, Any]:
    return yaml.safe_load((CONF / group / f"{name}.yaml").read_text("utf-8"))


FAMILIES = [name for name in GROUPS["task"] if "/" in name]
TASKS = [
    each for name in GROUPS["task"] if name not in FAMILIES for each in read_choice("task", name).values()
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("group", "name"), [(group, name) for group, names in GROUPS.items() for name in names]
)
def test_every_choice_composes(group, name):
    assert experiment(f"{group}={name}").tasks


@pytest.mark.slow
@pytest.mark.parametrize("group", ["task", "arch", "constraints"])
def test_all_means_every_file_of_the_group(group):
    everything = getattr(
        experiment(f"{group}=all"),
        {"task": "tasks", "arch": "archs", "constraints": "constraint_sets"}[group],
    )
    excluded = {"all", "separate_both", "separate_coordinated"}  # arch=all is the paper's four
    assert sorted(each.name for each in everything) == [
        name for name in GROUPS[group] if name not in (*excluded, *FAMILIES)
    ]


def test_rows_of_the_ablation_are_the_papers():
    rows = {row.name: (row.spatial, row.temporal) for row in experiment("constraints=all").constraint_sets}
    names = ("logical", "logical_temporal", "logical_spatial", "full")
    assert rows == dict(zip(names, product((False, True), repeat=2), strict=True))


def test_the_paper_profile_has_the_papers_settings():
    paper = experiment("profile=paper")
    assert (paper.demos, paper.scenes, paper.pictures.width, paper.pictures.height) == (150, 100, 320, 240)
    policy, training = paper.policy, paper.training
    assert (policy.horizon, policy.observation_steps, policy.acting.action_steps) == (8, 3, 6)
    assert (training.batch_size, training.epochs, training.warmup_steps) == (128, 300, 500)
    assert (training.learning_rate, training.betas, training.epsilon) == (1e-4, (0.95, 0.999), 1e-8)


# Dataclasses that are also made without conf/ and therefore have defaults; compared with conf/ below.
MADE_WITHOUT_CONF = {
    TrainConfig,  # its seed is train_seed
    ConstraintSet,  # for callers that name no row of the ablation
    Observations,  # constructed by environments and foreign policies
    Clutter,  # drawn at random, in no file of conf/
    Variation,  # for tasks outside of experiments; tests/tasks compares it with conf/variation/none.yaml
}
ENTRIES = {  # dataclasses with optional fields in conf/ -> all their entries there
    Task: TASKS,
    RobotSpec: [each for task in TASKS for each in task["robots"]],
    ObjectSpec: [each for task in TASKS for each in task["objects"].values()],
    CameraSpec: [each for task in TASKS for each in task["cameras"].values()],
    Arch: [each for name in GROUPS["arch"] if name != "all" for each in read_choice("arch", name).values()],
}
OPTIONAL = {
    "Task.step_limit",  # for tasks whose expert has not been measured
    "CameraSpec.eye_m", "CameraSpec.target_m",  # for a camera on a gripper
    "CameraSpec.fov_deg",  # for scenes without pictures
}  # fmt: skip


def parts(kind: object) -> set[type]:
    """All dataclasses in the fields of a type, recursively."""
    own = {kind} if isinstance(kind, type) and is_dataclass(kind) else set()
    inner = get_type_hints(kind).values() if own else get_args(kind)
    return own.union(*map(parts, inner))


def optional_fields(kind: type) -> set[str]:
    """The optional fields of a dataclass."""
    return {
        each.name
        for each in fields(kind)
        if each.default is not MISSING or each.default_factory is not MISSING
    }


def test_defaults_are_in_conf_alone():
    """Fields that conf/ always sets have no default in code."""
    # conf/ only names a robot.
    kinds = (parts(Experiment) | parts(Settings)) - MADE_WITHOUT_CONF - parts(Robot)
    duplicated = {
        f"{kind.__name__}.{name}"
        for kind in kinds
        for name in optional_fields(kind)
        if all(name in each for each in ENTRIES.get(kind, ()))
    }
    assert not ENTRIES.keys() - kinds and duplicated >= OPTIONAL
    assert not (wrong := sorted(duplicated - OPTIONAL)), f"take away what conf/ has: {', '.join(wrong)}"


def test_defaults_in_code_equal_those_of_conf():
    (full,) = experiment().constraint_sets
    assert full == ConstraintSet("full")
    assert [each.name for each in fields(TrainConfig) if each.default is not MISSING] == ["seed"]


def test_default_settings_without_a_command_equal_those_of_a_command(lift_barrier):
    configured = experiment("policy=paper")
    (task,), (row,) = configured.tasks, configured.constraint_sets
    assert Settings.configured(lift_barrier, row, configured.brain) == configured.settings(task, row)


def test_a_task_may_override_single_keys_of_the_randomisation():
    (usual,) = experiment().tasks
    (task,) = experiment("+task.lift_barrier.randomisation.mass_scale=0.5", "randomisation.light=0.3").tasks
    assert task.randomisation == replace(usual.randomisation, mass_scale=0.5, light=0.3)
