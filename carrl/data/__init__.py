"""Where transitions come from and where they are kept: collector and replay buffer."""
