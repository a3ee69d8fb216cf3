"""Policies of others: what they are told and give, made by a factory or asked of a server: docs/foreign.md.

`spec` is what `conf/` says, `factory` and `remote` are the two ways to a policy, `wire` is how arrays
travel, and `runner` lets it act in the rollouts of the suite.
"""
