"""Pictures of tracks, laps and cars."""
