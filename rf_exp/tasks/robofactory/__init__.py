"""The authors' release (RoboFactory) in our tasks: its cameras, their names, and its assets."""
