"""Policies in the control loop: from observations to chunks of targets; the rollout and the shield."""
