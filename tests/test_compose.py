"""Tasks composed from sentences: accepted and refused sentences, and the task files that are written."""

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
OBJECTS = ("cube", "cube", "bowl:pot", "lid")


def jobs_of(text: str, *objects: str) -> dict[str, Job]:
    parsed = compose(text, objects, "composed", "composed.composed").parsed
    return {job.thing: job for job in parsed.jobs}


def test_a_sentence_becomes_jobs_and_an_order() -> None:
    parsed = compose(BOTH, OBJECTS, "both", "composed.both").parsed
    assert parsed.arms == 2
    assert parsed.jobs == (
        Job("blue_cube", "center", "bowl", "inside1"),
        Job("red_cube", "center", "bowl", "inside2"),
        Job("lid", "knob", "bowl", "rim", ("blue_cube", "red_cube")),
    )


def test_a_sentence_may_go_over_several_lines() -> None:
    """The comment of the YAML file has it in one line."""
    composed = compose(
        "two arms put both cubes\ninto the\tbowl, the lid goes on last", OBJECTS, "both", "composed.both"
    )
    assert composed.yaml.startswith("# two arms put both cubes into the bowl, the lid goes on last\nboth:\n")


@pytest.mark.parametrize("name", ["lift_barrier", "ring", "all"])
def test_a_name_in_use_is_refused(name: str) -> None:
    with pytest.raises(ArgumentError, match=f"name is '{name}', which task={name} means already"):
        compose(BOTH, OBJECTS, name, f"composed.{name}")


@pytest.mark.parametrize(
    "text",
    [
        "two arms put the red cube and the blue cube into the bowl; then the lid goes onto the bowl",
        "2 robots place all cubes in the bowl, after that the lid is put on the bowl",
        "two robotic arms drop both cubes into the bowl and then the lid goes on top of the bowl",
    ],
)
def test_paraphrases_give_the_same_jobs(text: str) -> None:
    jobs = jobs_of(text, *OBJECTS)
    assert set(jobs["lid"].after) == {"red_cube", "blue_cube"}
    assert {jobs[name].target for name in jobs} == {"bowl"}


def test_stacked_objects_are_placed_in_order() -> None:
    jobs = jobs_of("arm 1 stacks all cubes on the goal", "cube", "cube", "cube", "goal")
    assert [(job.thing, job.target, job.after) for job in jobs.values()] == [
        ("blue_cube", "goal", ()),
        ("red_cube", "blue_cube", ("blue_cube",)),
        ("green_cube", "red_cube", ("red_cube",)),
    ]
    assert {job.agent for job in jobs.values()} == {1}


def test_the_word_first_sets_the_order() -> None:
    text = "the red cube goes onto the plinth, the blue cube goes onto the goal first"
    jobs = jobs_of(text, "red_cube", "blue_cube", "plinth", "goal")
    assert jobs["red_cube"].after == ("blue_cube",) and jobs["blue_cube"].after == ()


def test_objects_receive_unique_names() -> None:
    objects = parse_objects(["cube", "cube", "green_cube", "bowl:pot", "shoe", "shoe"])
    assert list(objects) == ["blue_cube", "red_cube", "green_cube", "bowl", "shoe1", "shoe2"]
    assert objects["green_cube"]["options"] == {"colour": "green"}
    assert objects["bowl"]["asset"] == "pot"


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
def test_unsuitable_sentences_are_refused_with_the_reason(text: str, objects: str, message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        compose(text, objects.split(), "composed", "composed.composed")
    assert message in str(error.value)


def test_more_objects_than_fit_within_reach_are_refused() -> None:
    goals = [f"goal{k}:goal" for k in range(1, 8)]
    shoes = [f"shoe{k}:shoe" for k in range(1, 8)]
    text = ", ".join(f"shoe{k} goes onto goal{k}" for k in range(1, 8))
    with pytest.raises(ArgumentError, match=r"7 things to move do not fit round goal1, .*: shoe1 would be"):
        compose(text, [*shoes, *goals], "composed", "composed.composed")


def test_towers_that_are_too_high_are_refused() -> None:
    cubes = [f"cube{k}:cube" for k in range(1, 11)]
    with pytest.raises(ArgumentError, match=r"cube9 would stand 0\.\d+ m over the table; arms build up to"):
        compose("arm 1 stacks all cubes on the goal", [*cubes, "goal"], "composed", "composed.composed")


def test_other_files_are_not_overwritten(tmp_path: Path) -> None:
    composed = compose(BOTH, OBJECTS, "both", "composed.both")
    paths = write_files(composed, tmp_path)
    assert write_files(composed, tmp_path) == paths  # identical files are accepted
    node = OmegaConf.load(paths[0])
    assert node.both.description == BOTH
    paths[1].write_text("mine")
    with pytest.raises(ArgumentError, match=r"both\.py is there already and is another; choose another name"):
        write_files(composed, tmp_path)


@pytest.mark.slow
def test_the_expert_solves_a_composed_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    composed = compose(BOTH, OBJECTS, "both_in", "rf_composed.both_in")
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
    result = subprocess.run(
        [sys.executable, "-m", "rf_exp.compose", *arguments], cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 2 and message in result.stderr + result.stdout


REQUEST = "tidy up: the cubes belong in the bowl, which has to be shut in the end; take two robots"


def run_compose(server: LanguageServer, tmp_path: Path, *keys: str) -> "subprocess.CompletedProcess[str]":
    arguments = [f"objects=[{','.join(OBJECTS)}]", "name=tidy", "episodes=0", "brain=openai", *keys]
    return subprocess.run(
        [sys.executable, "-m", "rf_exp.compose", REQUEST, *arguments, f"brain.base_url={server.url}"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def sentence_reply(text: str) -> Reply:
    return completion(json.dumps({"Sentence": text}))


def test_a_model_rephrases_until_the_grammar_accepts_it(tmp_path: Path) -> None:
    replies = [
        completion("Away with them!"),
        sentence_reply("two arms put both cubes into the box"),
        sentence_reply(BOTH),
    ]
    with LanguageServer(replies) as server:
        result = run_compose(server, tmp_path)
    assert result.returncode == 0, result.stderr
    assert "understood as: Two arms put both cubes into the bowl" in " ".join(result.stdout.split())
    task = compose(BOTH, OBJECTS, "tidy", "composed.tidy")
    assert (tmp_path / "composed" / "tidy.py").read_text() == task.module
    prompts = [request["messages"][-1]["content"] for request in server.requests]
    assert len(prompts) == 3 and all(REQUEST in str(each) for each in prompts)
    assert "Away with them!" in str(prompts[1]) and "there is no 'box'" not in str(prompts[1])
    assert "there is no 'box'" in str(prompts[2])


def test_a_model_without_a_valid_answer_stops_at_its_budget(tmp_path: Path) -> None:
    with LanguageServer([sentence_reply("do something nice")]) as server:
        result = run_compose(server, tmp_path, "brain.budget=2")
    assert result.returncode == 1
    assert "the budget of 2 calls is used up" in " ".join(result.stderr.split())
    assert len(server.requests) == 2 and not (tmp_path / "composed").exists()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (("brain=scripted",), "brain 'scripted'; available: openai"),
        (("brain.model=x",), "brain.model=x is of a language model; say brain=openai as well"),
        (("brain=openai", "brain.modle=x"), "modle"),
        (("brain=openai", "brain.budget=0"), "brain.budget is 0; it must be at least 1"),
    ],
)
def test_keys_of_a_model_are_checked_before_the_first_request(
    keys: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "rf_exp.compose", REQUEST, "objects=[cube]", *keys],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2 and message in " ".join(result.stderr.split()), result.stderr
