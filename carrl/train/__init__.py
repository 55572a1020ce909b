"""A run: its trainer, folder and checkpoints."""
