"""Data set tools: summary, validation and merging of stores, import and export of other formats."""
