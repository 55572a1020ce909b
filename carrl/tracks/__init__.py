"""Tracks: geometry, files, generators, inspection."""
