"""Pictures of runs, drawn without pyplot: no display, no global state, safe in any thread."""
