"""Presentation of results: tables, pictures and sliders."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from allocator.presentation.plotting import name_axes as name_axes
    from allocator.presentation.plotting import new_axes as new_axes
    from allocator.presentation.plotting import new_figure as new_figure
    from allocator.presentation.sliders import Range as Range
    from allocator.presentation.sliders import explore as explore
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
