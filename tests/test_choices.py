"""Everything in conf/ composes and becomes a valid experiment; `all` means all there is."""

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


def said(group: str, name: str) -> dict[str, Any]:
    return yaml.safe_load((CONF / group / f"{name}.yaml").read_text("utf-8"))


FAMILIES = [name for name in GROUPS["task"] if "/" in name]
TASKS = [each for name in GROUPS["task"] if name not in FAMILIES for each in said("task", name).values()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("group", "name"), [(group, name) for group, names in GROUPS.items() for name in names]
)
def test_every_choice_composes(group, name):
    assert experiment(f"{group}={name}").tasks


@pytest.mark.slow
@pytest.mark.parametrize("group", ["task", "arch", "constraints"])
def test_all_means_every_file_there_is(group):
    everything = getattr(
        experiment(f"{group}=all"),
        {"task": "tasks", "arch": "archs", "constraints": "constraint_sets"}[group],
    )
    ours = {"all", "separate_both", "separate_coordinated"}  # arch=all is the paper's four
    assert sorted(each.name for each in everything) == [
        name for name in GROUPS[group] if name not in (*ours, *FAMILIES)
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


# What is read from elsewhere than conf/, or made by hand, and so has defaults; they are held to conf/ below.
WITH_DEFAULTS = {
    TrainConfig,  # its seed is train_seed
    ConstraintSet,  # of who names no row of the ablation
    Observations,  # of environments and policies of others, which are made by hand
    Clutter,  # drawn, by no file of conf/
    Variation,  # of tasks that no experiment reads; conf/variation/none.yaml is compared in tests/tasks
}
FILES = {  # what a file of conf/ may leave out: kind -> all that conf/ says of such
    Task: TASKS,
    RobotSpec: [each for task in TASKS for each in task["robots"]],
    ObjectSpec: [each for task in TASKS for each in task["objects"].values()],
    CameraSpec: [each for task in TASKS for each in task["cameras"].values()],
    Arch: [each for name in GROUPS["arch"] if name != "all" for each in said("arch", name).values()],
}
LEFT_OUT_ELSEWHERE = {
    "Task.step_limit",  # of a task whose expert nobody has measured yet
    "CameraSpec.eye_m", "CameraSpec.target_m",  # of a camera on a hand
    "CameraSpec.fov_deg",  # of scenes that nobody looks at
}  # fmt: skip


def parts(kind: object) -> set[type]:
    """The dataclasses that the values of a type are made of."""
    found = {kind} if isinstance(kind, type) and is_dataclass(kind) else set()
    inner = get_type_hints(kind).values() if found else get_args(kind)
    return found.union(*map(parts, inner))


def defaults(kind: type) -> set[str]:
    """The fields that may be left out."""
    return {
        each.name
        for each in fields(kind)
        if each.default is not MISSING or each.default_factory is not MISSING
    }


def test_a_default_lives_in_conf_alone():
    """What conf/ always says has no default beside it."""
    kinds = (parts(Experiment) | parts(Settings)) - WITH_DEFAULTS - parts(Robot)  # conf/ only names a robot
    doubled = {
        f"{kind.__name__}.{name}"
        for kind in kinds
        for name in defaults(kind)
        if all(name in each for each in FILES.get(kind, ()))
    }
    assert not FILES.keys() - kinds and doubled >= LEFT_OUT_ELSEWHERE
    assert not (wrong := sorted(doubled - LEFT_OUT_ELSEWHERE)), (
        f"take away what conf/ has: {', '.join(wrong)}"
    )


def test_defaults_beside_conf_say_what_conf_says():
    (full,) = experiment().constraint_sets
    assert full == ConstraintSet("full")
    assert [each.name for each in fields(TrainConfig) if each.default is not MISSING] == ["seed"]


def test_settings_of_who_has_no_command_are_those_of_the_command(lift_barrier):
    said = experiment("policy=paper")
    (task,), (row,) = said.tasks, said.constraint_sets
    assert Settings.configured(lift_barrier, row, said.brain) == said.settings(task, row)


def test_a_task_may_randomise_other_than_the_experiment_key_by_key():
    (usual,) = experiment().tasks
    (task,) = experiment("+task.lift_barrier.randomisation.mass_scale=0.5", "randomisation.light=0.3").tasks
    assert task.randomisation == replace(usual.randomisation, mass_scale=0.5, light=0.3)
