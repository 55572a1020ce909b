"""XML that nobody vouches for, as a tree of bounded size: no file but the one named is read, and no entity expanded."""

from pathlib import Path
from xml.etree.ElementTree import Element
from xml.parsers import expat

from carrl.errors import TrackError
from carrl.files import read_whole

MOST_ELEMENTS, MOST_DEPTH = 200_000, 64
MAX_XML_BYTES = 8 * 2**20
"""A tree takes up to twenty times as much memory as its file; the largest of TORCS's 38 tracks has 0.2 MiB."""


def read_xml(path: Path) -> Element:
    """The root of an XML file, without text between its elements, of which track formats have none.

    References to external entities, such as the surfaces that TORCS's tracks share, stand for nothing. Bytes that are
    no UTF-8, such as an author's name that an old editor left in a comment, are read as Latin-1.

    Raises:
        TrackError: the file is no XML, too large a tree, or declares entities of its own.
    """
    content = read_whole(path, MAX_XML_BYTES, f"track '{path.name}'", TrackError)
    try:
        return _Tree(path).grow(content)
    except expat.ExpatError as error:
        try:
            content.decode("utf-8")
        except UnicodeDecodeError:
            if error.code == expat.errors.codes[expat.errors.XML_ERROR_INVALID_TOKEN]:
                return _read_as_latin_1(path, content)
        raise _not_xml(path, error) from None
    except (ValueError, LookupError):  # from the codec of a declared encoding, which may be any of Python's
        raise TrackError(f"track '{path.name}': the encoding of this XML is not read; save it as UTF-8") from None


def _read_as_latin_1(path: Path, content: bytes) -> Element:
    try:
        return _Tree(path, "utf-8").grow(content.decode("latin-1").encode())
    except expat.ExpatError as error:
        raise _not_xml(path, error) from None


def _not_xml(path: Path, error: expat.ExpatError) -> TrackError:
    reason = expat.ErrorString(error.code)
    return TrackError(f"track '{path.name}': line {error.lineno}: this is not well-formed XML: {reason}")


class _Tree:
    """Grows a tree of elements, and stops where it becomes too large.

    Args:
        path: of the file, for messages.
        encoding: instead of the one that the file declares.
    """

    def __init__(self, path: Path, encoding: str | None = None) -> None:
        self._name = path.name
        self._parser = expat.ParserCreate(encoding)
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.EntityDeclHandler = self._refuse_entity
        self._open = [Element("")]
        self._count = 0

    def grow(self, content: bytes) -> Element:
        """The root of the document."""
        self._parser.Parse(content, True)
        return self._open[0][0]

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MOST_ELEMENTS or len(self._open) > MOST_DEPTH:
            raise TrackError(
                f"track '{self._name}': the XML has more than {MOST_ELEMENTS} elements, or more than {MOST_DEPTH} "
                "within each other"
            )
        element = Element(tag, attributes)
        self._open[-1].append(element)
        self._open.append(element)

    def _end(self, _tag: str) -> None:
        self._open.pop()

    def _refuse_entity(self, name: str, _is_parameter: bool, value: str | None, *_rest: str | None) -> None:
        if value is not None:  # an external one has none
            raise TrackError(
                f"track '{self._name}': the entity '{name[:40]}' is declared in the file; write out what it stands for"
            )


class _RootFoundError(Exception):
    """Ends the parser at the first element, whose name is in it."""


def root_tag(path: Path) -> str:
    """The name of the outermost element of an XML file, of which no more is read than its beginning.

    Raises:
        TrackError: it has none.
    """

    def stop(tag: str, _attributes: dict[str, str]) -> None:
        raise _RootFoundError(tag)

    parser = expat.ParserCreate()
    parser.StartElementHandler = stop
    try:
        parser.Parse(read_whole(path, MAX_XML_BYTES, f"track '{path.name}'", TrackError), True)
    except _RootFoundError as found:
        return str(found)
    except (expat.ExpatError, ValueError, LookupError):
        pass
    return read_xml(path).tag  # for what is wrong with it
