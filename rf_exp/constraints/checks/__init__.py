"""The checks, a small class each: `planned` is what it finds of a plan, `measured` what of a scene."""
