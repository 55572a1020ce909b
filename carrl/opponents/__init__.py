"""Cars that nobody learns to drive: what drives them among those that learn."""
