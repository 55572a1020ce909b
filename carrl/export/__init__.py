"""Logs for other tools."""
