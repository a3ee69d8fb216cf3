"""Training of policies, and the folder that a trained policy is kept in."""
