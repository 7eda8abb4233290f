"""Presentation of results: tables, pictures and sliders."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from allocator.presentation.plotting import Range as Range
    from allocator.presentation.plotting import explore as explore
    from allocator.presentation.plotting import name_axes as name_axes
    from allocator.presentation.plotting import new_axes as new_axes
    from allocator.presentation.plotting import new_figure as new_figure
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
