"""Result rows, statistics, the paper's tables and the report. Never needs torch or a simulator."""
