"""Training: a policy for each view of an architecture, in as many rounds as the expert corrects them."""

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from rf_exp.policy import CURVES, MODEL, PolicyConfig, TrainConfig, View, device_of, train
from rf_exp.processes import in_order
from rf_exp.progress import Progress, console
from rf_exp.stages.artifacts import owned
from rf_exp.stages.cell import Cell
from rf_exp.stages.correction import correct, demonstrations
from rf_exp.stages.logs import Follower, curve_log
from rf_exp.stages.redrawing import redraw
from rf_exp.store import Store

SAVING_S = 20.0  # a training that is told to end may take so long for its last step and for saving


def train_policies(cell: Cell) -> None:
    """One policy for each view of the architecture, from the first `demos` episodes.

    Then anew for each round in which the expert corrects them, from its corrections as well. Each policy in a
    process of its own: on a CPU they are trained side by side, as a small network gains little from a second
    core.
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
            processes = min(len(views), experiment.workers) if device_of(config.device).type == "cpu" else 1
            # Small networks are too small for threads: they would spend their time waiting for each other.
            large = experiment.policy.encoder.large
            threads = max(1, (os.cpu_count() or 1) // processes) if large else 1
            made_with = demos, experiment.policy, config, threads
            followers = [
                Follower(folder / view.name / CURVES, stack.enter_context(curve_log(now, view.name)))
                for view in views
            ]
            jobs = [partial(_train, data, view, folder / view.name, *made_with) for view in views]
            with Progress(title, 1, "steps") as progress:
                follow = partial(_follow, followers, progress)
                for _ in in_order(jobs, processes, grace_s=SAVING_S, meanwhile=follow):
                    pass
                follow()
            if there:
                console.print(f"{title}: {len(views)} policies are there, nothing to do")


def _follow(followers: Sequence[Follower], progress: Progress) -> None:
    """Shows what has been learned since the last time."""
    for follower in followers:
        for curve, steps in follower.new():
            progress.advance(steps, f"loss {curve.loss:.4f}", curve.steps * len(followers))


def _train(
    data: Path, view: View, folder: Path, demos: int, policy: PolicyConfig, config: TrainConfig, threads: int
) -> None:
    """One policy, in the process it is called in, which holds the right to make it itself."""
    torch.set_num_threads(threads)
    with owned(folder):
        train(
            Store.open(data).first(demos), view, policy, config, folder, shared=folder.parents[1] / "encoders"
        )
