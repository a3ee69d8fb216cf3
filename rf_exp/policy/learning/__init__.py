"""Training of policies, and the folder that holds a trained policy."""
