"""Experiment: the configuration of `conf/` as plain values, checked before any work begins."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from rf_exp.artifacts import read_values
from rf_exp.datagen.brain import BrainSpec, FaultySpec, OpenAISpec, read_brain
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.keys import checked_folder
from rf_exp.launch import Launch
from rf_exp.policy import Foreign, PolicyConfig, TrainConfig, foreign_policy, read_recipe
from rf_exp.tasks import ReleaseParts, Task, Variation, load_task
from rf_exp.types import FOREIGN, UNVARIED, Arch, ConstraintSet, Extras, JointLimits, Occupancy, Pictures

if TYPE_CHECKING:
    from rf_exp.datagen import Settings

STAGES = ("generate", "train", "evaluate", "report")
_FILE_NAME_PATTERN = re.compile(r"[\w+=-][\w.+=-]{0,99}")
EVALUATION_SEED = 1_000_000  # first scene seed of evaluation; generation stays below it
CORRECTION_SEED = 900_000  # first scene seed of the rollouts that the expert corrects
CORRECTION_SEEDS = 10_000  # seeds per round of correction


@dataclass(frozen=True)
class Dagger:
    """DAgger: the expert continues failed rollouts, and policies learn from that too (Ross et al. 2011)."""

    rounds: int
    rollouts: int  # per round, by the policies of the round before; successful ones count too

    def __post_init__(self) -> None:
        for name, low, high in (("rounds", 0, 9), ("rollouts", 1, CORRECTION_SEEDS)):
            if not low <= (value := getattr(self, name)) <= high:
                raise ArgumentError(f"dagger.{name} is {value}; expected {low} to {high}")


@dataclass(frozen=True)
class Experiment:
    """One job: tasks x sets of constraints x architectures, and what is done with them."""

    tasks: tuple[Task, ...]
    constraint_sets: tuple[ConstraintSet, ...]
    archs: tuple[Arch, ...]
    brain: BrainSpec
    stages: tuple[str, ...]
    out: Path
    recipe: str
    learned_as: str
    name: str
    seed: int
    episodes: int | None
    demos: int
    workers: int
    seed_limit_s: float
    launch: Launch
    pictures: Pictures
    store: Extras
    occupancy: Occupancy
    attempts: int
    limits: JointLimits
    disturbance_rad: float
    delay_s: float
    recordings: int | tuple[int, ...]
    films: int
    policy: PolicyConfig
    training: TrainConfig
    train_seed: int
    dagger: Dagger
    wandb: Literal["online", "offline", "disabled"]
    scenes: int
    first_scene: int  # scene seed
    shield: bool
    foreign: Foreign | None
    appearances: int  # copies of each demonstration for training, under different appearances
    evaluated: Variation  # of the scenes of evaluation; `tasks` have that of the demonstrations

    def __post_init__(self) -> None:
        for key in ("name", "recipe", "learned_as"):
            check_file_name(key, getattr(self, key))
        for kind, members in (
            ("task", self.tasks),
            ("constraints", self.constraint_sets),
            ("arch", self.archs),
        ):
            for member in members:
                check_file_name(kind, member.name)
        if not self.stages:
            raise ArgumentError(f"stages is empty; available: {', '.join(STAGES)}")
        if unknown := [stage for stage in self.stages if stage not in STAGES]:
            raise ArgumentError(f"unknown stage {unknown[0]!r}; available: {', '.join(STAGES)}")
        lowest = dict.fromkeys(("seed", "films", "train_seed"), 0)
        lowest |= dict.fromkeys(("demos", "workers", "seed_limit_s", "attempts", "scenes", "appearances"), 1)
        lowest |= {"episodes": 1} if self.episodes is not None else {}
        for key, low in lowest.items():
            if not low <= getattr(self, key) < math.inf:
                raise ArgumentError(f"{key} is {getattr(self, key)}; it must be at least {low}")
        unseen = [task.variation.name for task in self.tasks if not task.variation.varies_visually]
        if self.appearances > 1 and unseen:
            raise ArgumentError(
                f"appearances is {self.appearances}, and variation {unseen[0]!r} shows nothing in pictures; "
                "choose one that does, or appearances=1"
            )
        if self.first_scene < EVALUATION_SEED:
            raise ArgumentError(
                f"first_scene is {self.first_scene}; seeds of evaluation begin with {EVALUATION_SEED}"
            )
        self._check_recordings()
        if self.seed + (self.episodes or self.demos) > EVALUATION_SEED:
            raise ArgumentError(
                f"seed is {self.seed}; generation must stay below {EVALUATION_SEED}, "
                "where the seeds of evaluation begin"
            )
        if self.foreign is not None:
            self._check_foreign(self.foreign)
        if isinstance(self.brain, OpenAISpec):
            self.brain.check(self.pictures)
        if not self.pictures.render:
            self._check_blind()

    def _check_blind(self) -> None:
        needs_pictures = self.policy.encoder.pictures and self.foreign is None
        if needs_pictures and {"train", "evaluate"} & set(self.stages):
            raise ArgumentError(
                "render=false makes no pictures to learn from; use it with stages=[generate], "
                "or with policy.encoder.name=privileged"
            )
        for key in ("depth", "segmentation"):
            if getattr(self.store, key):
                raise ArgumentError(f"store.{key}=true is seen by the cameras, and render=false has none")
        if self.occupancy == "depth":
            raise ArgumentError(
                "occupancy=depth looks through the depth cameras, and render=false has none; "
                "use render=true or occupancy=state"
            )

    def _check_foreign(self, foreign: Foreign) -> None:
        if "train" in self.stages or self.dagger.rounds:
            raise ArgumentError(
                f"foreign.name is {foreign.name!r}: a policy of others is evaluated, and neither trained nor "
                "corrected; use stages=[evaluate,report] dagger.rounds=0"
            )
        if foreign.observations.needs_rendering and not self.pictures.render and "evaluate" in self.stages:
            raise ArgumentError(
                "render=false makes no pictures for a policy of others to see; use render=true, or "
                "foreign.observations.pictures=false"
            )

    @property
    def evaluation_seeds(self) -> range:
        """The scene seeds of evaluation."""
        return range(self.first_scene, self.first_scene + self.scenes)

    @property
    def learned_from(self) -> int:
        """The number of demonstrations behind the evaluated policies, as in their rows."""
        return self.demos if self.foreign is None else self.foreign.demos

    @property
    def method(self) -> str:
        """The training method, as in names and rows: recipe, variation, rounds of correction."""
        return self.recipe + self._training_suffix + self._dagger_suffix

    @property
    def policies(self) -> str:
        """The name of the policies: method (`learned_as`), number of demonstrations, training seed."""
        return f"{self.learned_as}{self._training_suffix}{self._dagger_suffix}-{self.demos}-{self.train_seed}"

    @property
    def data(self) -> str:
        """The name of the demonstrations."""
        return self.name + self._variation_suffix

    @property
    def _training_suffix(self) -> str:
        return self._variation_suffix + (f"x{self.appearances}" if self.appearances > 1 else "")

    @property
    def _variation_suffix(self) -> str:
        names = {task.variation.name for task in self.tasks if self.foreign is None} - {UNVARIED}
        return "".join(f"+{name}" for name in sorted(names))

    @property
    def _dagger_suffix(self) -> str:
        return f"+dagger{self.dagger.rounds}" if self.dagger.rounds else ""

    def after_rounds(self, rounds: int) -> "Experiment":
        """The same experiment after `rounds` rounds of correction."""
        return replace(self, dagger=replace(self.dagger, rounds=rounds))

    def _check_recordings(self) -> None:
        if isinstance(self.recordings, int):
            if self.recordings < 0:
                raise ArgumentError(
                    f"recordings is {self.recordings}; it must be at least 0, a number of first seeds, "
                    f"or a list of seeds, e.g. recordings=[3,{EVALUATION_SEED}]"
                )
            return
        for seed in self.recordings:
            stage = "generate" if seed < EVALUATION_SEED else "evaluate"
            if seed < 0 or stage not in self.stages:
                raise ArgumentError(
                    f"recordings names seed {seed}; expected seeds from 0 on, recorded by stage generate, or "
                    f"from {EVALUATION_SEED} on, by evaluate; stages is [{', '.join(self.stages)}]"
                )

    def recorded(self, stage: Literal["generate", "evaluate"], first: Sequence[int]) -> tuple[int, ...]:
        """The seeds of a stage that are recorded: those listed, or the first `recordings` of `first`."""
        if isinstance(self.recordings, int):
            return tuple(first[: self.recordings])
        return tuple(seed for seed in self.recordings if (seed < EVALUATION_SEED) == (stage == "generate"))

    def settings(self, task: Task, constraint_set: ConstraintSet) -> "Settings":
        """The settings of the episodes of a task under a row of constraints."""
        from rf_exp.datagen import Settings

        options = self.limits, self.attempts, self.occupancy, self.disturbance_rad, self.delay_s
        return Settings(task, constraint_set, self.brain, *options)


def check_file_name(key: str, value: str) -> None:
    """Raises ArgumentError unless `value` can name one file or folder; a path could lead out of `out`."""
    if not _FILE_NAME_PATTERN.fullmatch(value):
        raise ArgumentError(
            f"{key} is {value!r}; expected a name for a file: letters, digits, '_', '-', '+', '=' and '.', "
            "not first a '.', at most 100 of them"
        )


def read_experiment(node: Mapping[str, Any], overrides: Collection[str] = ()) -> Experiment:
    """The experiment of a resolved configuration. Raises ArgumentError that names the key.

    `overrides` are the user's overrides `key=value`.
    """
    for group, allows_all in (("task", True), ("constraints", True), ("arch", True), ("brain", False)):
        if not node.get(group):
            possible = f"{group}=NAME or {group}=all" if allows_all else f"{group}=NAME"
            raise ArgumentError(f"no {group} chosen; use {possible}")
    if node["occupancy"] not in get_args(Occupancy):
        raise unknown_choice("occupancy", node["occupancy"], get_args(Occupancy))
    picture = node["picture"]
    foreign = foreign_policy(node["foreign"], picture)
    try:
        camera_options = {**picture, "render": node["render"], "cameras": node["cameras"]}
        derived: dict[str, Any] = {  # fields made of several keys, or of keys with another name
            "tasks": (),
            "constraint_sets": tuple(ConstraintSet(name, **row) for name, row in node["constraints"].items()),
            "archs": tuple(Arch(name, **arch) for name, arch in node["arch"].items()),
            "brain": read_brain(node["brain"]),
            "out": Path(checked_folder(node["out"])),
            "pictures": read_values(Pictures, camera_options, "picture."),
            "policy": read_recipe(node["policy"], picture),  # policies see the cameras' pictures
            "foreign": foreign,
            "evaluated": read_values(Variation, node["evaluated"], "evaluated.").held_out,
        }
        if foreign is not None:  # its rows name it in place of our recipe and architecture
            derived |= {"recipe": foreign["name"], "archs": (FOREIGN,)}
        plain = {item.name: node[item.name] for item in fields(Experiment) if item.name not in derived}
        experiment = read_values(Experiment, plain | derived)
        if any(override.startswith("demos=") for override in overrides):
            _refuse_demos_without_effect(experiment)
        borrowed = ReleaseParts(**{item.name: node[item.name] for item in fields(ReleaseParts)})
        randomisation, variation = (
            node["randomisation"],
            read_values(Variation, node["variation"], "variation."),
        )
        shared_arguments, tasks = (node["arms"], node["things"], node["robot"], borrowed), []
        for name, task in node["task"].items():  # last: building their objects takes longer than the rest
            task_node = {**task, "randomisation": randomisation | task.get("randomisation", {})}
            tasks.append(replace(load_task(name, task_node, *shared_arguments), variation=variation))
        experiment = replace(experiment, tasks=tuple(tasks))
        if isinstance(experiment.brain, FaultySpec) and "generate" in experiment.stages:
            for task in experiment.tasks:
                experiment.brain.fits(task)
        return experiment
    except TypeError as error:
        raise ArgumentError(f"configuration: {error}") from error


def _refuse_demos_without_effect(experiment: Experiment) -> None:
    """Raises ArgumentError where `episodes` is given and `demos` is not trained on, or exceeds it."""
    given = f"episodes={experiment.episodes} demos={experiment.demos}"
    if experiment.episodes is None or "generate" not in experiment.stages:
        return
    if not {"train", "evaluate"} & set(experiment.stages):
        raise ArgumentError(
            f"{given}: episodes already says how much is generated, and nothing is trained; give only one: "
            "episodes=N for N consecutive seeds, episodes=null demos=N for N successes"
        )
    if experiment.demos > experiment.episodes:
        raise ArgumentError(
            f"{given}: {experiment.episodes} seeds cannot give {experiment.demos} demonstrations; "
            "give demos no more than episodes, or episodes=null"
        )
