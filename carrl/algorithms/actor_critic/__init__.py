"""Actors that steer by numbers, and critics that value what they do: DDPG, TD3 and SAC."""
