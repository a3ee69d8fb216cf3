"""Generation of checked demonstrations: RoboBrain, motion, the loop."""
