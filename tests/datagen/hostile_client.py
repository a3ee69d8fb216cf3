"""Client of the hostile servers in a separate process, so that its memory can be measured.

Reads a JSON list of [address, number of calls, deadline in seconds] from the standard input; prints a JSON
object: `outcomes`, the address, reason and wall time of each call, and `peak_mb`, the peak memory in MB.
"""

import json
import os
import resource
import sys
import time
from pathlib import Path

import yaml

from rf_exp.datagen.brain import BadAnswer, Question, ScriptedBrain, read_brain
from rf_exp.types import ConstraintSet
from tests.conftest import CONF, read_task
from tests.datagen.guard import Guard
from tests.scenes import start_scene

BASE_OPTIONS = {"api_key_env": "TEST_KEY", "retries": 0, "restate": False, "exchanges": None}
LIMIT = 4 * 2**30  # bytes of address space, so that a failure does not exhaust the memory of the machine


def main() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT, LIMIT))
    os.environ |= {"TEST_KEY": "sk-test-0123456789abcdefghij", "NO_PROXY": "127.0.0.1"}
    task, guard, outcomes = read_task("lift_barrier"), Guard(), []
    question = Question(task, start_scene(task, 0), {})
    guard.prepare(ScriptedBrain().answer(question), task)
    for number, (url, calls, deadline_s) in enumerate(json.load(sys.stdin)):
        options = {"base_url": url, "timeout_s": deadline_s, "deadline_s": deadline_s, "budget": calls}
        spec = read_brain(yaml.safe_load((CONF / "brain/openai.yaml").read_text()) | BASE_OPTIONS | options)
        brain = spec.make(task, ConstraintSet("full"), 0)
        for _ in range(calls):
            began = time.perf_counter()
            guard.on = number > 0  # calls to the first server import lazily loaded modules
            try:
                text = brain.answer(question)
            except BadAnswer as error:
                reason = str(error)
            else:
                guard.on = False
                reason = guard.digest(text, task)
            guard.on = False
            assert not guard.seen, guard.seen
            outcomes.append({"url": url, "reason": reason, "wall_s": time.perf_counter() - began})
    # The peak since the start of this program; `ru_maxrss` begins with that of the parent process.
    peak_kb = next(line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line)
    peak_mb = int(peak_kb.split()[1]) / 1024
    print(json.dumps({"outcomes": outcomes, "peak_mb": peak_mb}))


if __name__ == "__main__":
    main()
