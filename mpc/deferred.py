"""A deferred object is filled in when somebody looks at it: a sample does not wait for what nobody looks at."""

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar


class Deferred:
    """A deferred object is filled in when an attribute is looked at that is put off."""

    _put_off: ClassVar[tuple[str, ...]] = ()  # the attributes that are

    def defer(self, fill: Callable[..., None], *values: object) -> None:
        """Have `fill(self, *values)` set later what is put off."""
        for name in self._put_off:
            self.__dict__.pop(name, None)
        self.__dict__["_fill"] = fill, values

    def catch_up(self) -> None:
        """Fill it in now if that was deferred."""
        if (deferred := self.__dict__.pop("_fill", None)) is not None:
            fill, values = deferred
            fill(self, *values)

    if not TYPE_CHECKING:  # else every misspelt attribute would be one

        def __getattr__(self, name: str) -> object:
            """Fill it in, and look again."""
            if "_fill" not in self.__dict__:
                raise AttributeError(f"a {type(self).__name__} has no {name!r}", name=name, obj=self)
            self.catch_up()
            return getattr(self, name)

    def __getstate__(self) -> dict[str, object]:
        self.catch_up()
        return self.__dict__.copy()
