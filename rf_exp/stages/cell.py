"""A cell of the experiment: one task, one set of constraints and, from training on, one architecture.

It defines the paths of its artifacts below `out`, a layout that external scripts rely on, and their
identities: all that decides their bytes beside the seeds, configuration and assets by content, code by
version. An artifact is made under a lock, and an existing one must have been made alike.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

from rf_exp import artifacts
from rf_exp.ablation import EvaluationRow, GenerationRow, read_rows, rows_file
from rf_exp.datagen import COORDINATOR_VERSION, Settings, generator_version
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import Experiment
from rf_exp.policy import SHIELD_VERSION, View, views
from rf_exp.store import Description, Store
from rf_exp.tasks import Task
from rf_exp.types import Arch, ConstraintSet, Pictures

R = TypeVar("R", GenerationRow, EvaluationRow)


@dataclass(frozen=True)
class Cell:
    """One task under one set of constraints in an experiment; with an architecture for policies."""

    experiment: Experiment
    task: Task
    constraint_set: ConstraintSet
    optional_arch: Arch | None = None

    def with_arch(self, arch: Arch) -> "Cell":
        """The same cell for the policies of an architecture."""
        return replace(self, optional_arch=arch)

    def after_rounds(self, rounds: int) -> "Cell":
        """The same cell after `rounds` rounds of correction."""
        return replace(self, experiment=self.experiment.after_rounds(rounds))

    @property
    def arch(self) -> Arch:
        """The architecture of its policies. Only cells of policies have one."""
        assert self.optional_arch is not None, f"{self.label} is a cell of demonstrations"
        return self.optional_arch

    @property
    def evaluated_task(self) -> Task:
        """The task with the variation of the evaluation scenes."""
        return replace(self.task, variation=self.experiment.evaluated)

    @property
    def views(self) -> tuple[View, ...]:
        """The views of its policies, one each: what the policy observes and commands."""
        return views(self.arch, len(self.task.agents))

    @property
    def label(self) -> str:
        """The names of its parts, e.g. `lift_barrier/full/separate_local`."""
        parts = self.task, self.constraint_set, self.optional_arch
        return "/".join(each.name for each in parts if each is not None)

    def title(self, stage: str) -> str:
        """Its title in a stage on the terminal, e.g. `train lift_barrier/full/separate_local`."""
        rounds = self.experiment.dagger.rounds if self.optional_arch else 0
        return f"{stage} {self.label}" + (f", correction {rounds}" if rounds else "")

    @property
    def data_path(self) -> Path:
        """The store of its demonstrations."""
        out, name = self.experiment.out, self.experiment.data
        return out / "data" / self.task.name / self.constraint_set.name / f"{name}{self._brain_suffix}.zarr"

    @property
    def _brain_suffix(self) -> str:
        """The suffix in file names for brains other than the scripted one."""
        brain_label = self.experiment.brain.label
        return "" if brain_label == ScriptedSpec.name else f"-by-{brain_label}"

    @property
    def generation_path(self) -> Path:
        """The rows of generation."""
        name = self.constraint_set.name
        if self.experiment.disturbance_rad:
            name += "-disturbed" if self.experiment.delay_s else "-disturbed-punctual"
        if self.task.variation.identity:
            name += f"-in-{self.task.variation.name}"
        name += self._brain_suffix
        return self.experiment.out / "results" / "generate" / self.task.name / f"{name}.jsonl"

    def shards_path(self, digest: str) -> Path:
        """The folder of the shards with this digest, each of which is an `out` of its own."""
        return self.experiment.out / "shards" / f"{self.task.name}-{self.constraint_set.name}-{digest}"

    @property
    def redrawn_path(self) -> Path:
        """The store of redrawn demonstrations, several copies of each."""
        source = self.corrected_path if self.experiment.dagger.rounds else self.data_path
        return source.with_stem(f"{source.stem}-{self.experiment.demos}x{self.experiment.appearances}")

    @property
    def corrected_path(self) -> Path:
        """The store of demonstrations, with corrections of the policies of the round before."""
        return self.data_path.with_name(f"corrected-{self.arch.name}-{self.experiment.policies}.zarr")

    @property
    def correction_path(self) -> Path:
        """The rows of a round of correction."""
        name = f"{self.constraint_set.name}-{self.experiment.policies}.jsonl"
        return self.experiment.out / "results" / "correct" / self.task.name / self.arch.name / name

    @property
    def policy_path(self) -> Path:
        """The folder of its policies, with a subfolder for each view."""
        parts = self.task.name, self.constraint_set.name, self.arch.name, self.experiment.policies
        return self.experiment.out.joinpath("policies", *parts)

    @property
    def evaluation_path(self) -> Path:
        """The rows of evaluation."""
        experiment, names = self.experiment, (self.task.name, self.constraint_set.name, self.arch.name)
        parts = experiment.method, experiment.learned_from, experiment.shield, experiment.evaluated.name
        return experiment.out / rows_file(*names, *parts)

    def recording_path(self, stage: str, seed: int) -> Path:
        """The recording of a scene of a stage."""
        folder = self.experiment.out / "recordings" / self.task.name / self.constraint_set.name
        return folder / f"{stage}-{seed}.rrd"

    @property
    def settings(self) -> Settings:
        """The settings of its episodes."""
        return self.experiment.settings(self.task, self.constraint_set)

    @property
    def generation_identity(self) -> dict[str, Any]:
        """The identity of the rows of generation."""
        settings = self.settings
        identity = {
            **artifacts.drop_defaults(asdict(settings), disturbance_rad=0.0, delay_s=0.0),
            "task": self.task.name,
            "scene": self.task.identity,
            "version": self.task.version,
            "generator": generator_version(self.task),
            "brain": settings.brain.identity,
        }
        if settings.brain.reads:
            identity["told"] = [self.task.title, self.task.description, self.task.target_condition]
        if settings.brain.reads or self.experiment.occupancy == "depth":
            identity["seen"] = self.experiment.pictures
        return artifacts.plain(identity)

    def store_identity(self, pictures: Pictures) -> dict[str, Any]:
        """The identity of demonstrations with these pictures."""
        size = (pictures.height, pictures.width) if pictures.render else (0, 0)
        return {
            **self.generation_identity,
            **artifacts.drop_defaults(asdict(self.experiment.store), depth=False, segmentation=False),
            "first_seed": self.experiment.seed,
            "cameras": [*pictures.camera_names(len(self.task.agents))],
            "picture": [*size],
        }

    def correction_identity(self, step_limit: int, policies: dict[str, Any]) -> dict[str, Any]:
        """The identity of a round of correction; `policies` is the provenance of the corrected policies."""
        experiment = self.experiment
        identity = {
            **self.generation_identity,
            "demos": experiment.demos,
            "rollouts": experiment.dagger.rollouts,
            "step_limit": step_limit,
            "policies": policies,
            "acting": experiment.policy.identity,
        }
        return artifacts.plain(identity)

    def evaluation_identity(self, step_limit: int) -> dict[str, Any]:
        """The identity of evaluation, without the policies, which differ by training seed."""
        experiment = self.experiment
        identity: dict[str, Any] = {"shield": SHIELD_VERSION} if experiment.shield else {}
        if self.arch.coordinated:  # its plans are made as in undisturbed generation
            undisturbed = replace(self, experiment=replace(experiment, disturbance_rad=0.0))
            identity |= {"coordinator": COORDINATOR_VERSION, "plans": undisturbed.generation_identity}
        identity |= {
            "task": self.task.name,
            "scene": self.evaluated_task.identity,
            "demos": experiment.learned_from,
            "pictures": [experiment.pictures.width, experiment.pictures.height],
            "step_limit": step_limit,
        }
        if (foreign := experiment.foreign) is not None:
            identity |= {"foreign": foreign.identity, "velocity_rad_s": experiment.limits.velocity_rad_s}
        else:
            identity |= {"policy": experiment.policy.identity, "training": experiment.training.identity}
        return artifacts.plain(identity)


def cells(experiment: Experiment) -> Iterator[Cell]:
    """The cells of an experiment, each task under each of its sets of constraints; without architectures."""
    for task, constraint_set in product(experiment.tasks, experiment.constraint_sets):
        yield Cell(experiment, task, constraint_set)


def known_rows(path: Path, kind: type[R]) -> tuple[R, ...]:
    """The rows in a file; none if it does not exist yet."""
    return read_rows(path, kind) if path.exists() else ()


def shared_fields(kind: type[R], outcome: object) -> dict[str, Any]:
    """The fields of a row that `outcome`, an outcome or a rollout, has by the same name."""
    return {each.name: getattr(outcome, each.name) for each in fields(kind) if hasattr(outcome, each.name)}


def evaluation_rows(cell: Cell) -> list[EvaluationRow]:
    """The rows of the cell's policies in the scenes of the experiment."""
    scenes, key = cell.experiment.evaluation_seeds, (cell.experiment.train_seed, cell.task.version)
    rows = known_rows(cell.evaluation_path, EvaluationRow)
    return [row for row in rows if row.scene_seed in scenes and (row.train_seed, row.version) == key]


@contextmanager
def artifact_lock(
    artifact: Path, configuration: Mapping[str, Any] | None = None, companions: Sequence[Path] = ()
) -> Iterator[None]:
    """Context that holds the lock of an artifact; other jobs wait for it, and print who holds it.

    Removes half-written files of killed jobs beside it. With `configuration`, the artifact must be made
    from that (`same_configuration`; `companions` is made together with it). Raises StageError naming what
    differs, ArgumentError where nothing can be written.
    """
    with ExitStack() as stack:
        try:
            artifact.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(artifacts.locked(artifact.with_name(f".{artifact.name}.lock"), str(artifact)))
        except OSError as error:
            raise ArgumentError(
                f"cannot write below {artifact.parent}: {error.strerror}; "
                "choose another folder with out=FOLDER"
            ) from error
        artifacts.remove_stale_drafts(artifact.parent)
        if configuration is not None:
            same_configuration(artifact, configuration, artifact.exists(), companions)
        yield


def same_configuration(
    artifact: Path, configuration: Mapping[str, Any], exists: bool, companions: Sequence[Path] = ()
) -> None:
    """Records an artifact's configuration, or compares if `exists`. Raises StageError naming what differs."""
    record = artifacts.configuration_file(artifact)
    if not exists:
        artifacts.write_json(record, configuration)
        return
    listed = ", ".join(map(str, [artifact, record, *(path for path in companions if path.exists())]))
    remedy = f"delete {listed}, or choose another folder with out=FOLDER"
    if not record.exists():
        raise StageError(f"{artifact} is there, and {record} that says what it was made of is not; {remedy}")
    artifacts.expect_same(artifact, artifacts.read_json(record, remedy), configuration, remedy)


def open_or_create(
    path: Path, identity: Mapping[str, Any], source: Store, task: Task, description: Description | None
) -> Store:
    """A store for writing, with the arrays of `source`: the existing one with `identity`, or a new one.

    Raises StageError for an imported `source`, whose scenes cannot be made again.
    """
    if "imported" in source.identity:
        raise StageError(
            f"{source.path} was imported: its scenes cannot be made again, so its episodes are neither drawn "
            "anew (redraw, appearances) nor corrected by the expert (dagger.rounds)"
        )
    if path.exists():
        return Store.open(path, identity, writable=True)
    attrs = source.attrs
    size = (
        attrs["agents"],
        attrs["cameras"],
        attrs["height"],
        attrs["width"],
        attrs["objects"],
        source.disturbed,
    )
    return Store.create(path, identity, *size, description, [each.model for each in task.robots])
