"""Pictures and films of expert episodes: `python -m rf_exp.gallery task=all out=outputs`."""
