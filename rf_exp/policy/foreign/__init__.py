"""Foreign policies (not trained by this suite), from a factory or on a server: docs/foreign.md."""
