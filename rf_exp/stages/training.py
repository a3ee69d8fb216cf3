"""Training: a policy for each view of an architecture, again after each round of correction by the expert.

DAgger: the policies of a round act in scenes of their own. In a failed rollout, a moment is drawn at which an
arm was moving; the policies' commands are replayed up to it, and RoboBrain, planner and RoboChecker continue
(Ross et al. 2011; the expert finishes the episode, Kelly et al. 2019). The policies' part is stored too,
marked as no agent's subgoal, and not learned from. The rows count the proposals asked of the expert.
"""

import os
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from rf_exp.artifacts import write_text_if_changed
from rf_exp.datagen import Outcome, make_episode
from rf_exp.errors import StageError
from rf_exp.experiment import CORRECTION_SEED, CORRECTION_SEEDS
from rf_exp.findings import Account
from rf_exp.policy import CURVES, MODEL, PolicyConfig, TrainConfig, View, moving_target_mask, train
from rf_exp.processes import in_order
from rf_exp.progress import Progress, console
from rf_exp.stages.cell import Cell, artifact_lock, open_or_create
from rf_exp.stages.evaluation import policies_of, scene_evaluator, training_record
from rf_exp.stages.generation import attempts, collect
from rf_exp.stages.logs import Follower, run_log
from rf_exp.stages.redrawing import redraw
from rf_exp.store import Store, card
from rf_exp.types import CORRECTION, Rollout, RolloutStep

MAX_MOMENTS = 3  # at which the expert is tried, each half as late as the one before, until it succeeds
GRACE_S = 20.0  # what a training gets after SIGTERM for its last step and for saving


def train_policies(cell: Cell) -> None:
    """Trains one policy for each view of the architecture on the first `demos` episodes, anew in each round.

    Policies train in parallel, one process each: a small network gains little from a second core, and leaves
    a GPU idle while its kernels are launched.
    """
    for rounds in range(cell.experiment.dagger.rounds + 1):
        current = cell.after_rounds(rounds)
        if rounds:
            correct(current)
        experiment, folder, title, views = (
            current.experiment,
            current.policy_path,
            current.title("train"),
            current.views,
        )
        config = replace(experiment.training, seed=experiment.train_seed)
        with artifact_lock(folder), ExitStack() as stack:
            data, demos = training_data(current)
            if (copies := experiment.appearances) > 1:
                path, source = current.redrawn_path, Store.open(data).first(demos)
                data = redraw(source, path, current.task, current.task.variation, copies)
                demos *= copies
            complete = all((folder / view.name / MODEL).exists() for view in views)
            processes = min(len(views), experiment.workers)
            # Threads of a small network would spend their time waiting for each other.
            large = experiment.policy.encoder.large
            threads = max(1, (os.cpu_count() or 1) // processes) if large else 1
            arguments = demos, experiment.policy, config, threads
            logs = [stack.enter_context(run_log(current, "train", view.name)) for view in views]
            curves = [folder / view.name / CURVES for view in views]
            followers = list(map(Follower, curves, logs))
            jobs = [partial(_train, data, view, folder / view.name, *arguments) for view in views]
            with Progress(title, 1, "steps") as progress:
                follow = partial(_follow, followers, progress)
                for _ in in_order(jobs, processes, grace_s=GRACE_S, meanwhile=follow):
                    pass
                follow()
            if complete:
                console.print(f"{title}: {len(views)} policies are there, nothing to do")


def _follow(followers: Sequence[Follower], progress: Progress) -> None:
    for follower in followers:
        for curve, steps in follower.new():
            progress.advance(steps, f"loss {curve.loss:.4f}", curve.steps * len(followers))


def _train(
    data: Path, view: View, folder: Path, demos: int, policy: PolicyConfig, config: TrainConfig, threads: int
) -> None:
    torch.set_num_threads(threads)
    with artifact_lock(folder):
        store, encoders = Store.open(data).first(demos), folder.parents[1] / "encoders"
        train(store, view, policy, config, folder, fit_cache=encoders)


def training_data(cell: Cell) -> tuple[Path, int]:
    """The data set, and the number of its episodes to learn from. Raises StageError if it has too few."""
    if cell.experiment.dagger.rounds:
        return cell.corrected_path, len(Store.open(cell.corrected_path))
    path, wanted = cell.data_path, cell.experiment.demos
    if not path.exists():
        raise StageError(f"no data at {path}; run stages=[generate] first")
    available = len(Store.open(path))
    if available < wanted:
        raise StageError(
            f"{path} has {available} demonstrations, demos={wanted} were asked for; "
            "run stages=[generate] with that number first"
        )
    return path, wanted


def correct(cell: Cell) -> None:
    """Writes the data set of the round before with the expert's corrections; continues where it stopped.

    Raises StageError where the policies of the round before were not made as the experiment says.
    """
    experiment, rounds = cell.experiment, cell.experiment.dagger.rounds
    # The scenes vary as in generation, where the expert takes over, whatever the variation of evaluation.
    setup = replace(experiment.after_rounds(rounds - 1), shield=False, evaluated=cell.task.variation)
    acting_cell = replace(cell, experiment=setup)
    policies = policies_of(acting_cell)
    provenance = cell.correction_identity(policies.step_limit, training_record(acting_cell).provenance)
    data, demos = training_data(acting_cell)
    source = Store.open(data).first(demos)
    path, rows_path = cell.corrected_path, cell.correction_path
    with (
        artifact_lock(rows_path, provenance, [path]),
        artifact_lock(path),
        open_or_create(path, provenance, source, cell.task, source.description) as store,
    ):
        for index in range(len(store), len(source)):
            store.append(source.episode(index))
        plan_counts = Counter(tuple(map(tuple, each["subgoals"])) for each in source.certificates)
        expert = partial(
            make_episode,
            cell.settings,
            experiment.pictures,
            cameras=store.cameras,
            known=plan_counts.most_common(1)[0][0],  # the most frequent subgoal texts of each agent
            extras=store.extras,
        )
        first = CORRECTION_SEED + CORRECTION_SEEDS * (rounds - 1)
        seeds = range(first, first + experiment.dagger.rollouts)
        make_attempts = partial(
            attempts, cell, partial(_correct_scene, scene_evaluator(acting_cell, policies), expert)
        )
        collect(cell, "correct", store, rows_path, seeds, None, make_attempts, became="corrected")
        write_text_if_changed(path.with_suffix(".md"), card(store))


def _correct_scene(
    act: Callable[..., tuple[Rollout, float]], expert: Callable[..., Outcome], seed: int
) -> Outcome:
    steps: list[RolloutStep] = []
    rollout, wall_s = act(seed, watch=steps.append)
    if rollout.success:
        nothing = Account(ended="nothing to correct: success")
        return Outcome(seed, False, rollout.success_paper, 0, 0, 0, wall_s, nothing)
    commands = np.stack([step.action for step in steps])
    qpos = np.stack([step.scene.qpos for step in steps])
    moved = np.flatnonzero(np.any(moving_target_mask(qpos, commands)[1:], axis=1)) + 1
    moment = int(np.random.default_rng([seed, CORRECTION]).choice(moved)) if len(moved) else 0
    proposals = 0
    for lead in dict.fromkeys(moment >> halvings for halvings in range(MAX_MOMENTS)):
        outcome = expert(seed, lead=commands[:lead])
        proposals += outcome.attempts
        if outcome.success:
            break
    return replace(outcome, attempts=proposals, wall_s=wall_s + outcome.wall_s)
