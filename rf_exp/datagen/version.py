"""Version of the code that determines the bytes of an episode."""

from rf_exp.tasks import Task

# Covers everything between a proposal and the stored bytes: motion, checks, schedules, simulation, pictures.
# Raise it whenever a seed gives other bytes than before.
GENERATOR = "6"


def generator_version(task: Task) -> str:
    """`<generator>.<plan of the task>`: the same code, configuration and seed give the same episode."""
    return f"{GENERATOR}.{task.plan_version}"
