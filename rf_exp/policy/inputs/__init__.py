"""Inputs of a policy as arrays: views, observation specs, pictures, gripper history."""
