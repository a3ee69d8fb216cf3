"""Motion: inverse kinematics, primitives, collision-free paths, timing."""
