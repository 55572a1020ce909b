"""The formats of pictures, by the endings of their files' names; nothing here waits for Matplotlib."""

from pathlib import Path

from carrl.errors import CarrlError

ENDINGS = (".png", ".pdf", ".svg")


def picture_format(path: str | Path, name: str = "the picture's file") -> str:
    """The format that a file's name asks for, such as `png`.

    Args:
        path: of the file.
        name: what it is called in the message, such as `--out`.

    Raises:
        CarrlError: it asks for none that a picture can have.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise CarrlError(f"{name} is '{path}'; its name must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
    return ending[1:]
