"""Policies in the control loop: observations in, targets in chunks out; the shield and the rollout."""
