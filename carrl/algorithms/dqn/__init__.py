"""DQN and its descendants."""
