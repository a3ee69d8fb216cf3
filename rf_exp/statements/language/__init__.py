"""The grammar of sentences: notation of patterns, verbs, units, events and names, and the parser."""
