"""Everything in conf/ composes and becomes a valid experiment; `all` means all there is."""

from dataclasses import replace
from itertools import product

import pytest

from rf_exp.command import CONF
from tests.conftest import experiment

GROUPS = {
    group: sorted(path.stem for path in (CONF / group).glob("*.yaml"))
    for group in ("task", "arch", "constraints", "policy", "profile", "experiment", "brain")
}


@pytest.mark.parametrize(
    ("group", "name"), [(group, name) for group, names in GROUPS.items() for name in names]
)
def test_every_choice_composes(group, name):
    assert experiment(f"{group}={name}").tasks


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


def test_a_task_may_randomise_other_than_the_experiment_key_by_key():
    (usual,) = experiment().tasks
    (task,) = experiment("+task.lift_barrier.randomisation.heavy=0.5", "randomisation.light=0.3").tasks
    assert task.randomisation == replace(usual.randomisation, heavy=0.5, light=0.3)
