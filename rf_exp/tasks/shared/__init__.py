"""What several tasks share: a module for each thing that they do alike."""
