"""Feeds every parser with files as a careless or hostile stranger might make them."""
