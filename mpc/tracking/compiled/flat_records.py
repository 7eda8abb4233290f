"""The records of the compiled functions lie in flat arrays, which Python hands over in a fraction of the time.

numba opens a record argument field by field; at some dozens of arrays that takes longer than the step itself.
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.views import length_of, viewer
from mpc.tracking.compiled.records import Path, Reference, Setting


class Given(NamedTuple):
    """The given is what is new in a step."""

    x: Annotated[Array, 4]
    u: Annotated[Array, "N", 2]  # commands to begin from [Pa]
    d: Annotated[Array, "N"]  # [N·m]
    reference: Reference
    last: Annotated[Array, 2, 2]  # command and feed-forward of the previous sample [Pa]


class Along(NamedTuple):
    """A path and its commands."""

    path: Path
    u: Annotated[Array, "N", 2]  # [bar]


setting_in: Callable[[Array, NDArray[np.int64]], Setting] = viewer(Setting)
given_in: Callable[[Array], Given] = viewer(Given)
path_in: Callable[[Array], Along] = viewer(Along)


def lengths(N: int) -> tuple[int, int]:
    """Return the lengths of the buffers of a `Given` and of a path."""
    return length_of(Given, N), length_of(Along, N)
