"""One episode on a page: constraints, check code and verdicts in each phase (paper, supplementary A)."""
