"""Text of a file in any of the encodings that spreadsheets and loggers write."""

from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TypeAlias, TypeVar

from allocator.errors import InvalidFile, InvalidInput

FilePath: TypeAlias = str | PathLike[str]
P = TypeVar("P", bound=FilePath)

_LOOKED_AT = 4096  # bytes inspected to recognise UTF-16
_PACKED = (b"PK\x03\x04", b"\x1f\x8b")  # first bytes of zip archives (.xlsx) and gzip files
_LEAST = 4  # least number of characters to recognise it
_HALF = 0.4  # share of zeros among every second byte, above which it is UTF-16 without a mark


def short(paths: P | Sequence[P]) -> dict[str, P]:
    """Return one file or several by their names, or by their whole paths if two of them have the same name.

    Raises `InvalidInput` for a file that is given twice.
    """
    paths = [paths] if isinstance(paths, str | PathLike) else paths
    if len({Path(path).absolute() for path in paths}) < len(paths):
        raise InvalidInput(f"a file is given twice: {', '.join(map(str, paths))}")
    names = [Path(path).name for path in paths]
    return dict(zip(names if len(set(names)) == len(names) else map(str, paths), paths, strict=True))


def read_text(path: FilePath) -> str:
    """Return the text of `path`: UTF-8, UTF-16, or else Windows-1252. Raises `InvalidFile` if it is not text."""
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise InvalidFile(path, "does not exist") from None
    except OSError as error:
        raise InvalidFile(path, f"cannot be read ({error.strerror})") from None
    for encoding in () if data.startswith(_PACKED) else _encodings(data):
        try:
            text = data.decode(encoding).rstrip("\0")  # left at the end by a loss of power
        except UnicodeDecodeError:
            continue
        if "\0" in text:
            break
        return text
    raise InvalidFile(path, "is not a text file; save a spreadsheet as CSV")


def _encodings(data: bytes) -> tuple[str, ...]:
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        return ("utf-16",)
    begin = data[:_LOOKED_AT]
    for encoding, zeros in (("utf-16-le", begin[1::2]), ("utf-16-be", begin[::2])):
        if len(zeros) >= _LEAST and zeros.count(0) > _HALF * len(zeros):
            return (encoding,)
    return "utf-8-sig", "cp1252"
