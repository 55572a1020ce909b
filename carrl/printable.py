"""Text from files and names, made harmless for a terminal."""


def printable(text: str) -> str:
    """The text with every character that could steer a terminal, or hide in it, written as Python would escape it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
