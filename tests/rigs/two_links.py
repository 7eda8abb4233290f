"""A mechanism with bends and with muscles of two kinds, for tests of compiled and exported allocations."""

from allocator.mechanism import Link, Mechanism, Sites
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N


def two_links() -> Mechanism:
    """Return two links with six muscles between sites."""
    links = [Link(), Link(0, origin=(0.0, 0.3))]
    paths = [[(-1, (0.0, -0.3)), (0, (side * 0.03, 0.0))] for side in (-1, 1)]
    paths += [[(0, (0.0, 0.0)), (1, (side * 0.03, 0.0))] for side in (-1, 1)]
    paths += [[(-1, (0.0, -0.3)), (0, (side * 0.03, 0.0)), (1, (side * 0.02, 0.0))] for side in (-1, 1)]
    muscles = (SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N) * 3
    routes = Sites(0.4, links, paths, cable=[-0.0435] * 4 + [0.2565] * 2)
    return Mechanism(routes, muscles, angle_limits=((-0.5, 0.5), (-0.4, 0.4)))
