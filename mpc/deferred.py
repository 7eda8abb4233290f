"""Objects with attributes computed on first access, so a control step does not pay for unread results."""

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar


class Deferred:
    """Object that computes its deferred attributes on first access."""

    _put_off: ClassVar[tuple[str, ...]] = ()  # names of the deferred attributes

    def defer(self, fill: Callable[..., None], *values: object) -> None:
        """Have `fill(self, *values)` set the deferred attributes on first access."""
        for name in self._put_off:
            self.__dict__.pop(name, None)
        self.__dict__["_fill"] = fill, values

    def catch_up(self) -> None:
        """Set the deferred attributes now if they are pending."""
        if (deferred := self.__dict__.pop("_fill", None)) is not None:
            fill, values = deferred
            fill(self, *values)

    if not TYPE_CHECKING:  # for type checkers every misspelt attribute would exist

        def __getattr__(self, name: str) -> object:
            """Set the deferred attributes and return the named one. Raises `AttributeError` for unknown names."""
            if "_fill" not in self.__dict__:
                raise AttributeError(f"a {type(self).__name__} has no {name!r}", name=name, obj=self)
            self.catch_up()
            return getattr(self, name)

    def __getstate__(self) -> dict[str, object]:
        self.catch_up()
        return self.__dict__.copy()
