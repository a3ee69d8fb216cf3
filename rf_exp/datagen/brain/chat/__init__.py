"""A talk with a language model: its server, live, and its recording."""
