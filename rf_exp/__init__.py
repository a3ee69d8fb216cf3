"""RoboFactory experiments: several arms, one table, compositional constraints."""
