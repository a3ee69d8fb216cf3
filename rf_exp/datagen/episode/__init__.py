"""One episode: the loop that makes it, what is kept of it, who looks on, and what became of it."""
