"""The grammar of sentences: notation of forms, verbs, units, events and names, and how a sentence is read."""
