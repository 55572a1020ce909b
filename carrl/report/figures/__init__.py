"""The figures of `carrl report`, and the folder in which they stand beside its text."""
