"""The task class: configuration, starts of episodes, scene variation and evaluation of success."""
