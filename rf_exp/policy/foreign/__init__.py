"""Policies of others: what they observe and give, made by a factory or asked of a server: docs/foreign.md."""
