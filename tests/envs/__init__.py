"""Tests of the public environments: third-party checkers, guarantees, refused arguments."""
