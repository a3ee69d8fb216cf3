"""Extensions from outside the package: a task (docs/adding_a_task.md), a constraint, a verb, policy heads."""
