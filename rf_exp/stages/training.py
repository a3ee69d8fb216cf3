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

from rf_exp.artifacts import keep_text
from rf_exp.datagen import Outcome, make_episode
from rf_exp.errors import StageError
from rf_exp.experiment import CORRECTION_SEED, CORRECTION_SEEDS
from rf_exp.findings import Account
from rf_exp.policy import CURVES, MODEL, PolicyConfig, TrainConfig, View, sent_on, train
from rf_exp.processes import in_order
from rf_exp.progress import Progress, console
from rf_exp.stages.cell import Cell, continued, owned
from rf_exp.stages.evaluation import acting, learned, scene_of
from rf_exp.stages.generation import attempts, collect
from rf_exp.stages.logs import Follower, run_log
from rf_exp.stages.redrawing import redraw
from rf_exp.store import Store, card
from rf_exp.types import CORRECTION, Rollout, RolloutStep

MOMENTS = 3  # at which the expert is tried, each half as late as the one before, until it succeeds
SAVING_S = 20.0  # what a training gets after SIGTERM for its last step and for saving


def train_policies(cell: Cell) -> None:
    """Trains one policy for each view of the architecture on the first `demos` episodes, anew in each round.

    Policies train in parallel, one process each: a small network gains little from a second core, and leaves
    a GPU idle while its kernels are launched.
    """
    for rounds in range(cell.experiment.dagger.rounds + 1):
        now = cell.after(rounds)
        if rounds:
            correct(now)
        experiment, folder, title, views = now.experiment, now.policy_path, now.title("train"), now.views
        config = replace(experiment.training, seed=experiment.train_seed)
        with owned(folder), ExitStack() as stack:
            data, demos = demonstrations(now)
            if (copies := experiment.appearances) > 1:
                path, source = now.redrawn_path, Store.open(data).first(demos)
                data = redraw(source, path, now.task, now.task.variation, copies)
                demos *= copies
            there = all((folder / view.name / MODEL).exists() for view in views)
            processes = min(len(views), experiment.workers)
            # Threads of a small network would spend their time waiting for each other.
            large = experiment.policy.encoder.large
            threads = max(1, (os.cpu_count() or 1) // processes) if large else 1
            made_with = demos, experiment.policy, config, threads
            logs = [stack.enter_context(run_log(now, "train", view.name)) for view in views]
            curves = [folder / view.name / CURVES for view in views]
            followers = list(map(Follower, curves, logs))
            jobs = [partial(_train, data, view, folder / view.name, *made_with) for view in views]
            with Progress(title, 1, "steps") as progress:
                follow = partial(_follow, followers, progress)
                for _ in in_order(jobs, processes, grace_s=SAVING_S, meanwhile=follow):
                    pass
                follow()
            if there:
                console.print(f"{title}: {len(views)} policies are there, nothing to do")


def _follow(followers: Sequence[Follower], progress: Progress) -> None:
    for follower in followers:
        for curve, steps in follower.new():
            progress.advance(steps, f"loss {curve.loss:.4f}", curve.steps * len(followers))


def _train(
    data: Path, view: View, folder: Path, demos: int, policy: PolicyConfig, config: TrainConfig, threads: int
) -> None:
    torch.set_num_threads(threads)
    with owned(folder):
        store, encoders = Store.open(data).first(demos), folder.parents[1] / "encoders"
        train(store, view, policy, config, folder, shared=encoders)


def demonstrations(cell: Cell) -> tuple[Path, int]:
    """The data set, and the number of its episodes to learn from. Raises StageError if it has too few."""
    if cell.experiment.dagger.rounds:
        return cell.corrected_path, len(Store.open(cell.corrected_path))
    path, wanted = cell.data_path, cell.experiment.demos
    if not path.exists():
        raise StageError(f"no data at {path}; run stages=[generate] first")
    found = len(Store.open(path))
    if found < wanted:
        raise StageError(
            f"{path} has {found} demonstrations, demos={wanted} were asked for; "
            "run stages=[generate] with that number first"
        )
    return path, wanted


def correct(cell: Cell) -> None:
    """Writes the data set of the round before with the expert's corrections; continues where it stopped.

    Raises StageError where the policies of the round before were not made as the experiment says.
    """
    experiment, rounds = cell.experiment, cell.experiment.dagger.rounds
    # The scenes vary as in generation, where the expert takes over, whatever the variation of evaluation.
    acts = replace(experiment.after(rounds - 1), shield=False, evaluated=cell.task.variation)
    before = replace(cell, experiment=acts)
    policies = acting(before)
    provenance = cell.correction_identity(policies.step_limit, learned(before).provenance)
    data, demos = demonstrations(before)
    source = Store.open(data).first(demos)
    path, rows_path = cell.corrected_path, cell.correction_path
    with (
        owned(rows_path, provenance, [path]),
        owned(path),
        continued(path, provenance, source, cell.task, source.description) as store,
    ):
        for index in range(len(store), len(source)):
            store.append(source.episode(index))
        usual = Counter(tuple(map(tuple, each["subgoals"])) for each in source.certificates)
        expert = partial(
            make_episode,
            cell.settings,
            experiment.pictures,
            cameras=store.cameras,
            known=usual.most_common(1)[0][0],  # the most frequent subgoal texts of each agent
            extras=store.extras,
        )
        first = CORRECTION_SEED + CORRECTION_SEEDS * (rounds - 1)
        seeds = range(first, first + experiment.dagger.rollouts)
        made = partial(attempts, cell, partial(_corrected, scene_of(before, policies), expert))
        collect(cell, "correct", store, rows_path, seeds, None, made, became="corrected")
        keep_text(path.with_suffix(".md"), card(store))


def _corrected(
    act: Callable[..., tuple[Rollout, float]], expert: Callable[..., Outcome], seed: int
) -> Outcome:
    steps: list[RolloutStep] = []
    rolled, wall_s = act(seed, watch=steps.append)
    if rolled.success:
        nothing = Account(ended="nothing to correct: success")
        return Outcome(seed, False, rolled.success_paper, 0, 0, 0, wall_s, nothing)
    commands = np.stack([step.action for step in steps])
    qpos = np.stack([step.scene.qpos for step in steps])
    moved = np.flatnonzero(np.any(sent_on(qpos, commands)[1:], axis=1)) + 1
    moment = int(np.random.default_rng([seed, CORRECTION]).choice(moved)) if len(moved) else 0
    asked = 0
    for lead in dict.fromkeys(moment >> again for again in range(MOMENTS)):
        outcome = expert(seed, lead=commands[:lead])
        asked += outcome.attempts
        if outcome.success:
            break
    return replace(outcome, attempts=asked, wall_s=wall_s + outcome.wall_s)
