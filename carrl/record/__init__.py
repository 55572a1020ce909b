"""The log of transitions: one MCAP file a run, its schema, its writer and its reader."""
