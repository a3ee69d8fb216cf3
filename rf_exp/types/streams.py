"""Streams of random numbers of an episode: `default_rng([seed, STREAM, ...])`. Each serves one thing.

NumPy fills a seed up with zeros: who draws from `[seed, STREAM]` and from `[seed, STREAM, 0]` draws the same
numbers twice. Further numbers begin at 1 where that would be.
"""

# Faults of a brain are drawn where disturbances are.
SCENE, PLANNING, DISTURBANCES, CORRECTION, PIXELS, FLICKER, VARIATION = range(7)
