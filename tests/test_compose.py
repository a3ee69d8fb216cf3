"""Tasks from sentences: what is understood, what is refused and why, and that what is written works."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from rf_exp.compose import compose, parse_objects, write_files
from rf_exp.datagen import Settings, make_episode
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import ArgumentError
from rf_exp.tasks import load_task
from rf_exp.tasks.shared.jobs import Job
from rf_exp.types import NO_PICTURES, ConstraintSet
from tests.datagen.language_server import LanguageServer, Reply, completion

ROOT = Path(__file__).parents[1]
BOTH = "Two arms put both cubes into the bowl, the lid goes on last."
THINGS = ("cube", "cube", "bowl:pot", "lid")


def jobs_of(text: str, *objects: str) -> dict[str, Job]:
    said = compose(text, objects, "composed", "composed.composed").parsed
    return {job.thing: job for job in said.jobs}


def test_a_sentence_becomes_jobs_and_an_order() -> None:
    said = compose(BOTH, THINGS, "both", "composed.both").parsed
    assert said.arms == 2
    assert said.jobs == (
        Job("blue_cube", "center", "bowl", "inside1"),
        Job("red_cube", "center", "bowl", "inside2"),
        Job("lid", "knob", "bowl", "rim", ("blue_cube", "red_cube")),
    )


def test_a_sentence_may_go_over_several_lines() -> None:
    """And is one line in what is written, in a comment of the YAML file."""
    made = compose(
        "two arms put both cubes\ninto the\tbowl, the lid goes on last", THINGS, "both", "composed.both"
    )
    assert made.yaml.startswith("# two arms put both cubes into the bowl, the lid goes on last\nboth:\n")


@pytest.mark.parametrize("name", ["lift_barrier", "ring", "all"])
def test_a_name_that_is_taken_is_refused(name: str) -> None:
    with pytest.raises(ArgumentError, match=f"name is '{name}', which task={name} means already"):
        compose(BOTH, THINGS, name, f"composed.{name}")


@pytest.mark.parametrize(
    "text",
    [
        "two arms put the red cube and the blue cube into the bowl; then the lid goes onto the bowl",
        "2 robots place all cubes in the bowl, after that the lid is put on the bowl",
        "two robotic arms drop both cubes into the bowl and then the lid goes on top of the bowl",
    ],
)
def test_there_are_several_ways_to_say_it(text: str) -> None:
    jobs = jobs_of(text, *THINGS)
    assert set(jobs["lid"].after) == {"red_cube", "blue_cube"}
    assert {jobs[name].target for name in jobs} == {"bowl"}


def test_what_stands_on_another_thing_comes_after_it() -> None:
    jobs = jobs_of("arm 1 stacks all cubes on the goal", "cube", "cube", "cube", "goal")
    assert [(job.thing, job.target, job.after) for job in jobs.values()] == [
        ("blue_cube", "goal", ()),
        ("red_cube", "blue_cube", ("blue_cube",)),
        ("green_cube", "red_cube", ("red_cube",)),
    ]
    assert {job.agent for job in jobs.values()} == {1}


def test_what_comes_first() -> None:
    text = "the red cube goes onto the plinth, the blue cube goes onto the goal first"
    jobs = jobs_of(text, "red_cube", "blue_cube", "plinth", "goal")
    assert jobs["red_cube"].after == ("blue_cube",) and jobs["blue_cube"].after == ()


def test_things_have_names() -> None:
    found = parse_objects(["cube", "cube", "green_cube", "bowl:pot", "shoe", "shoe"])
    assert list(found) == ["blue_cube", "red_cube", "green_cube", "bowl", "shoe1", "shoe2"]
    assert found["green_cube"]["options"] == {"colour": "green"}
    assert found["bowl"]["asset"] == "pot"


@pytest.mark.parametrize(
    ("text", "objects", "message"),
    [
        ("put the banana into the pot", "steak pot", "there is no 'banana'; there are steak, pot"),
        ("put the steak into the cube", "steak cube pot", "nothing can be put into cube; what it can: pot"),
        (
            "put all cubes into the pot",
            "cube cube cube pot",
            "green_cube has no place into pot, which takes 2",
        ),
        ("put the cube into the pot", "cube cube pot", "'cube' means 1 of 2: blue_cube, red_cube; say which"),
        ("nine arms put the cube into the pot", "cube pot", "'nine' is no number of arms; expected 1 to 6"),
        ("9 arms put the cube into the pot", "cube pot", "speaks of 9 arms; possible are 1 to 6"),
        ("two arms put the cube into the pot", "cube pot", "2 arms, but things to move: 1; an arm would"),
        ("put the cube", "cube pot", "does not say where; forms: two arms put both cubes"),
        ("juggle", "cube pot", "cannot read 'juggle' of 'juggle'; forms:"),
        ("", "cube pot", "says nothing; forms:"),
        ("the goal goes onto the pot", "goal pot", "goal cannot be grasped"),
        ("put the cube onto the cube", "cube goal", "cube cannot be put on itself"),
        (
            "put the red cube onto the blue cube, then the blue cube goes onto the goal",
            "red_cube blue_cube goal",
            "moves blue_cube, on which red_cube has been put before",
        ),
        (
            "put the cube onto the goal, then put the cube onto the plinth",
            "cube goal plinth",
            "puts cube somewhere twice; a thing has one place",
        ),
        ("put the cube onto the goal", "cube lamp", "unknown object 'lamp'; available: barrier, "),
        ("put the cube onto the goal", "red_cube red_cube goal", "object 'red_cube' is there twice"),
        ("put the cube onto the goal", "a-b:cube goal", "the name is 'a-b'; expected letters, digits and _"),
        ("put the cube onto the goal", "", "objects is empty; available: barrier, "),
    ],
)
def test_what_does_not_fit_is_said(text: str, objects: str, message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        compose(text, objects.split(), "composed", "composed.composed")
    assert message in str(error.value)


def test_more_things_than_arms_reach_are_refused() -> None:
    goals = [f"goal{k}:goal" for k in range(1, 8)]
    shoes = [f"shoe{k}:shoe" for k in range(1, 8)]
    text = ", ".join(f"shoe{k} goes onto goal{k}" for k in range(1, 8))
    with pytest.raises(ArgumentError, match=r"7 things to move do not fit round goal1, .*: shoe1 would be"):
        compose(text, [*shoes, *goals], "composed", "composed.composed")


def test_towers_that_are_too_high_are_refused() -> None:
    cubes = [f"cube{k}:cube" for k in range(1, 11)]
    with pytest.raises(ArgumentError, match=r"cube9 would stand 0\.\d+ m over the table; arms build up to"):
        compose("arm 1 stacks all cubes on the goal", [*cubes, "goal"], "composed", "composed.composed")


def test_a_file_of_somebody_else_is_not_written_over(tmp_path: Path) -> None:
    composed = compose(BOTH, THINGS, "both", "composed.both")
    paths = write_files(composed, tmp_path)
    assert write_files(composed, tmp_path) == paths  # the same again
    node = OmegaConf.load(paths[0])
    assert node.both.description == BOTH
    paths[1].write_text("mine")
    with pytest.raises(ArgumentError, match=r"both\.py is there already and is another; choose another name"):
        write_files(composed, tmp_path)


@pytest.mark.slow
def test_the_expert_does_what_the_sentence_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    composed = compose(BOTH, THINGS, "both_in", "rf_composed.both_in")
    write_files(composed, tmp_path / "rf_composed")
    monkeypatch.syspath_prepend(tmp_path)
    task = load_task(composed.name, composed.node)
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    outcome = make_episode(settings, NO_PICTURES, 0)
    assert outcome.success and not outcome.contacts, outcome.reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["objects=[cube]"], "'objects=[cube]': expected one sentence, in quotes, then keys as KEY=VALUE"),
        (["put it", "there"], "'there': expected one sentence, in quotes, then keys as KEY=VALUE"),
        (["put it", "object=[cube]"], "unknown key 'object'; available: brain, episodes, name, objects, out"),
        (["put it", "objects=cube"], "objects is 'cube'; expected a list, as objects=[cube,cube,bowl:pot]"),
        (["put it", "objects=[cube]", "out=/tmp"], "out is '/tmp'; expected a folder below this one"),
        (["put it", "objects=[cube]", "episodes=-1"], "episodes is -1; expected 0 or more"),
    ],
)
def test_wrong_arguments(arguments: list[str], message: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rf_exp.compose", *arguments], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 2 and message in done.stderr + done.stdout


WISH = "tidy up: the cubes belong in the bowl, which has to be shut in the end; take two robots"


def composed_by(server: LanguageServer, tmp_path: Path, *keys: str) -> "subprocess.CompletedProcess[str]":
    arguments = [f"objects=[{','.join(THINGS)}]", "name=tidy", "episodes=0", "brain=openai", *keys]
    return subprocess.run(
        [sys.executable, "-m", "rf_exp.compose", WISH, *arguments, f"brain.base_url={server.url}"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def sentence(text: str) -> Reply:
    return completion(json.dumps({"Sentence": text}))


def test_a_model_says_it_again_until_the_grammar_understands(tmp_path: Path) -> None:
    replies = [
        completion("Away with them!"),
        sentence("two arms put both cubes into the box"),
        sentence(BOTH),
    ]
    with LanguageServer(replies) as server:
        done = composed_by(server, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "understood as: Two arms put both cubes into the bowl" in " ".join(done.stdout.split())
    task = compose(BOTH, THINGS, "tidy", "composed.tidy")
    assert (tmp_path / "composed" / "tidy.py").read_text() == task.module
    said = [request["messages"][-1]["content"] for request in server.requests]
    assert len(said) == 3 and all(WISH in str(each) for each in said)
    assert "Away with them!" in str(said[1]) and "there is no 'box'" not in str(said[1])
    assert "there is no 'box'" in str(said[2])


def test_a_model_that_never_makes_sense_ends_with_its_budget(tmp_path: Path) -> None:
    with LanguageServer([sentence("do something nice")]) as server:
        done = composed_by(server, tmp_path, "brain.budget=2")
    assert done.returncode == 1
    assert "the budget of 2 calls is used up" in " ".join(done.stderr.split())
    assert len(server.requests) == 2 and not (tmp_path / "composed").exists()


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (("brain=scripted",), "brain 'scripted'; available: openai"),
        (("brain.model=x",), "brain.model=x is of a language model; say brain=openai as well"),
        (("brain=openai", "brain.modle=x"), "modle"),
        (("brain=openai", "brain.budget=0"), "brain.budget is 0; it must be at least 1"),
    ],
)
def test_keys_of_a_model_are_checked_before_it_is_asked(
    keys: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rf_exp.compose", WISH, "objects=[cube]", *keys],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and said in " ".join(done.stderr.split()), done.stderr
