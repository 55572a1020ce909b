"""Watches the memory and the open files of one long training run."""
