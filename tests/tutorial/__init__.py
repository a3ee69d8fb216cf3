"""A task of one's own, outside of the package: see docs/adding_a_task.md."""
