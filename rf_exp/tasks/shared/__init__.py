"""Code shared by several tasks, one module per topic."""
