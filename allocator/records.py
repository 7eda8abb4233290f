"""The records of a CSV file, one a line."""

import csv
from collections.abc import Iterable, Iterator

from allocator.errors import InvalidFile


def records(path: object, lines: Iterable[tuple[int, str]], separator: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Give the cells of every numbered line; a quoted cell may not go on in the next one.

    Raises `InvalidFile`, with the line, for what is no CSV; `path` is for the message.
    """
    for number, line in lines:
        try:
            for cells in csv.reader([line], delimiter=separator, strict=True):
                yield number, cells
        except csv.Error as error:
            what = "a quotation mark is not closed" if "end of data" in str(error) else str(error)
            raise InvalidFile(path, f"is not CSV: {what}", line=number) from None


__all__ = ["records"]
