"""What a policy is shown and told, as arrays: views, observation specs, pictures, gripper history."""
