"""XML by expat, without entities: a document that declares any is refused before one is expanded."""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

from .form import damaged


def parse(parser: expat.XMLParserType, data: bytes, path: Path, place: str = "") -> None:
    """Let a parser read a whole document.

    Parameters
    ----------
    parser : expat parser
        With its handlers of elements and text.
    data : bytes
    path : Path
    place : str
        What comes before the line in an error, where the document is not a file of its own.

    Raises
    ------
    ModelError
        ``file:line: message``: no sound XML, entities, an encoding that is not known.
    """

    def entity(*_: object) -> None:
        line = f"{place}{parser.CurrentLineNumber}"
        raise damaged(path, line, "the document declares entities, which are refused", "write it plain")

    parser.EntityDeclHandler = entity
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise damaged(path, f"{place}{error.lineno}", f"not sound XML: {expat.ErrorString(error.code)}") from None
    except (LookupError, ValueError) as error:
        if "encoding" not in str(error):
            raise
        raise damaged(path, f"{place}1", f"{error}", "write UTF-8") from None
