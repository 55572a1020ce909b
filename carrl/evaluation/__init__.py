"""Rollouts, measures and the best lap."""
