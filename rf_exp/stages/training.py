"""Training: a policy for each view of an architecture, in as many rounds as the expert corrects them."""

import os
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
from rf_exp.store import Store

SAVING_S = 20.0  # a training that is told to end may take so long for its last step and for saving


def train_policies(cell: Cell) -> None:
    """One diffusion policy for each view of the architecture, from the first `demos` episodes.

    Then anew for each round in which the expert corrects them, from its corrections as well.
    """
    _train_all(cell.after(0))
    for rounds in range(1, cell.experiment.dagger.rounds + 1):
        correct(cell.after(rounds))
        _train_all(cell.after(rounds))


def _train_all(cell: Cell) -> None:
    """Each policy in a process of its own.

    On a CPU they are trained side by side, since a small network gains little from a second core.
    """
    experiment, folder, title = cell.experiment, cell.policy_path, cell.title("train")
    config = replace(experiment.training, seed=experiment.train_seed)
    with owned(folder), ExitStack() as stack:
        data, demos = demonstrations(cell)
        all_views = cell.views
        there = all((folder / view.name / MODEL).exists() for view in all_views)
        processes = min(len(all_views), experiment.workers) if device_of(config.device).type == "cpu" else 1
        # Our small networks are too small for threads: they would spend their time waiting for each other.
        small = experiment.policy.encoder != "resnet18"
        threads = 1 if small else max(1, (os.cpu_count() or 1) // processes)
        made_with = demos, experiment.policy, config, threads
        followers = [
            Follower(folder / view.name / CURVES, stack.enter_context(curve_log(cell, view.name)))
            for view in all_views
        ]
        jobs = [partial(_train, data, view, folder / view.name, *made_with) for view in all_views]
        with Progress(title, 1, "steps") as progress:

            def follow() -> None:
                for follower in followers:
                    for curve, steps in follower.new():
                        progress.advance(steps, f"loss {curve.loss:.4f}", curve.steps * len(followers))

            for _ in in_order(jobs, processes, grace_s=SAVING_S, meanwhile=follow):
                pass
            follow()
        if there:
            console.print(f"{title}: {len(all_views)} policies are there, nothing to do")


def _train(
    data: Path, view: View, folder: Path, demos: int, policy: PolicyConfig, config: TrainConfig, threads: int
) -> None:
    """One policy, in the process it is called in, which holds the right to make it itself."""
    torch.set_num_threads(threads)
    with owned(folder):
        train(Store.open(data).first(demos), view, policy, config, folder, shared=folder.parents[1] / "eyes")
