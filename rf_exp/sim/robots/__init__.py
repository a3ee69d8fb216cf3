"""A robot in the simulator: how ManiSkill loads it, and its joints as rows."""
