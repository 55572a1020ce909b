"""The command line: one `carrl` command, a file for each of its verbs."""
