"""Everything in conf/ composes and becomes a valid experiment; `all` means all there is."""

from dataclasses import MISSING, fields, is_dataclass, replace
from itertools import product
from typing import get_args, get_type_hints

import pytest

from rf_exp.command import CONF
from rf_exp.datagen import Settings
from rf_exp.experiment import Experiment
from rf_exp.observations import Observations
from rf_exp.policy import PolicyConfig, TrainConfig
from rf_exp.tasks import CameraSpec, ObjectSpec, RobotSpec, Task
from rf_exp.types import Arch, ConstraintSet
from tests.conftest import experiment

GROUPS = {
    group: sorted(path.stem for path in (CONF / group).glob("*.yaml"))
    for group in ("task", "arch", "constraints", "policy", "profile", "experiment", "brain")
}


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
    assert sorted(each.name for each in everything) == [name for name in GROUPS[group] if name not in ours]


def test_rows_of_the_ablation_are_the_papers():
    rows = {row.name: (row.spatial, row.temporal) for row in experiment("constraints=all").constraint_sets}
    names = ("logical", "logical_temporal", "logical_spatial", "full")
    assert rows == dict(zip(names, product((False, True), repeat=2), strict=True))


def test_the_paper_profile_has_the_papers_settings():
    paper = experiment("profile=paper")
    assert (paper.demos, paper.scenes, paper.pictures.width, paper.pictures.height) == (150, 100, 320, 240)
    policy, training = paper.policy, paper.training
    assert (policy.horizon, policy.observation_steps, policy.action_steps) == (8, 3, 6)
    assert (training.batch_size, training.epochs, training.warmup_steps) == (128, 300, 500)
    assert (training.learning_rate, training.betas, training.epsilon) == (1e-4, (0.95, 0.999), 1e-8)


# What is read from elsewhere than conf/, or made by hand, and so has defaults; they are held to conf/ below.
WITH_DEFAULTS = {
    PolicyConfig,  # read from what was stored before a field came
    TrainConfig,
    ConstraintSet,  # of who names no row of the ablation
    Arch,  # switches of ours, which the paper's four do not know
    Task,  # its file may leave out what most tasks do not need
    RobotSpec,
    ObjectSpec,
    CameraSpec,
    Observations,  # of environments and policies of others, which are made by hand
}


def parts(kind: object) -> set[type]:
    """The dataclasses that the values of a type are made of."""
    found = {kind} if isinstance(kind, type) and is_dataclass(kind) else set()
    inner = get_type_hints(kind).values() if found else get_args(kind)
    return found.union(*map(parts, inner))


def test_a_default_lives_in_conf_alone():
    doubled = [
        f"{kind.__name__}.{field.name}"
        for kind in sorted(
            (parts(Experiment) | parts(Settings)) - WITH_DEFAULTS, key=lambda kind: kind.__name__
        )
        for field in fields(kind)
        if field.default is not MISSING or field.default_factory is not MISSING
    ]
    assert not doubled, f"take away the defaults that conf/ has: {', '.join(doubled)}"


def test_defaults_beside_conf_say_what_conf_says():
    paper, (full,) = experiment("policy=paper"), experiment().constraint_sets
    assert (paper.policy, paper.training) == (PolicyConfig(), TrainConfig())
    assert full == ConstraintSet("full")


def test_settings_of_who_has_no_command_are_those_of_the_command(lift_barrier):
    said = experiment("policy=paper")
    (task,), (row,) = said.tasks, said.constraint_sets
    assert Settings.configured(lift_barrier, row, said.brain) == said.settings(task, row)


def test_a_task_may_randomise_other_than_the_experiment_key_by_key():
    (usual,) = experiment().tasks
    (task,) = experiment("+task.lift_barrier.randomisation.mass_scale=0.5", "randomisation.light=0.3").tasks
    assert task.randomisation == replace(usual.randomisation, mass_scale=0.5, light=0.3)
