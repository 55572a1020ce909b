"""What an episode is: actions, observations, rewards, starts and ends."""
