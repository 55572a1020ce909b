"""Kills training runs and damages their logs, and checks what is recovered of them against what was written."""
